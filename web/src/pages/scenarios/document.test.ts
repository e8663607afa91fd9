import { describe, expect, it } from 'vitest';
import { parseDocument } from 'yaml';
import { type Block, blocksOf, freeTask, type List } from './document';
import { editBetween } from './edits';
import { commentsOf } from './meaning';
import { destination, inserted, moved, pathAfter, pathThrough, removed } from './moves';
import type { BlockEdit } from './reading';

const TEXT = `# head
version: 1   # one
name: a

steps:
  # of one
  - {task: one, skill: work, robot: left}   # behind one

  # apart

  # of two
  - task: two
    skill: work
    # within two
    capacity: weld
    after: [one]
  - parallel:
      # of three
      - {task: three, skill: work, robot: left}
      - - {wait: 1}
        - {wait: 2}   # second
  - repeat:
      - {wait: 3}
      - {wait: 4}
    times: 2
  - parallel: [{wait: 5}, {wait: 6}]
  # the end
`;

const all = (list: List): Block[] => list.blocks.flatMap((one) => [one, ...one.lists.flatMap(all)]);
function blocks(text: string): Block[] {
  const { list, problem } = blocksOf(text);
  expect(problem).toBe('');
  return list ? all(list) : [];
}
function lists(text: string): List[] {
  const { list } = blocksOf(text);
  const below = (one: List): List[] => [one, ...one.blocks.flatMap((block) => block.lists.flatMap(below))];
  return list ? below(list) : [];
}
const comments = (text: string) => commentsOf(text).sort();
const stepsOf = (text: string) =>
  blocks(text)
    .filter((one) => !one.lists.length)
    .map((one) => `${one.kind} ${one.title}`);
/** What stands in a text but for indentation, dashes and brackets. */
const words = (text: string) =>
  text
    .split(/[\s,[\]{}]+/)
    .filter((one) => one && one !== '-')
    .sort();

describe('blocksOf', () => {
  it('tells the tree', () => {
    expect(blocks(TEXT).map((one) => [one.path, one.kind, one.title, one.detail, one.fixed])).toEqual([
      ['steps/0', 'task', 'one', 'work → left', ''],
      ['steps/1', 'task', 'two', 'work → weld ⇠ one', ''],
      ['steps/2', 'parallel', '', '', ''],
      ['steps/2/parallel/0', 'task', 'three', 'work → left', ''],
      ['steps/2/parallel/1', 'branch', '', '', ''],
      ['steps/2/parallel/1/0', 'wait', '1', '', ''],
      ['steps/2/parallel/1/1', 'wait', '2', '', ''],
      ['steps/3', 'repeat', '', '× 2', ''],
      ['steps/3/repeat/0', 'wait', '3', '', ''],
      ['steps/3/repeat/1', 'wait', '4', '', ''],
      ['steps/4', 'parallel', '', '', ''],
      ['steps/4/parallel/0', 'wait', '5', '', ''],
      ['steps/4/parallel/1', 'wait', '6', '', ''],
    ]);
    expect(blocks(TEXT)[0]?.line).toBe(7);
  });
  it('says why a text cannot be read', () => {
    expect(blocksOf('steps: [').problem).not.toBe('');
    expect(blocksOf('name: a').list?.blocks).toEqual([]);
    expect(blocksOf('- 1').list?.blocks).toEqual([]);
  });
});

describe('edits', () => {
  it('take a step away with the comments that are its own', () => {
    expect(removed(TEXT, 'steps/0')).toBe(TEXT.replace(/ {2}# of one\n.*behind one\n/, ''));
    expect(removed(TEXT, 'steps/1')).toBe(TEXT.replace(/ {2}# of two\n[^]*after.*\n/, ''));
    expect(removed(TEXT, 'steps/4')).toBe(TEXT.replace(/ {2}- parallel: \[.*\n/, ''));
  });
  it('put a line in, and nothing else', () => {
    expect(inserted(TEXT, 'steps/3/repeat', 1, '{wait: 9}')).toBe(
      TEXT.replace('      - {wait: 4}', '      - {wait: 9}\n      - {wait: 4}'),
    );
    const bare = 'steps:\n- {wait: 1}';
    expect(inserted(bare, 'steps', 1, '{wait: 2}')).toBe('steps:\n- {wait: 1}\n- {wait: 2}\n');
  });
  it('move steps into, out of and past others, with their indentation', () => {
    const into = moved(TEXT, 'steps/1', 'steps/3/repeat', 1) ?? '';
    expect(into).toContain('      # of two\n      - task: two\n        skill: work\n        # within two\n');
    const out = moved(TEXT, 'steps/2/parallel/0', 'steps', 2) ?? '';
    expect(out).toContain(
      '  # of three\n  - {task: three, skill: work, robot: left}\n  - parallel:\n      - - {wait: 1}',
    );
  });
  it('put a step of several lines in', () => {
    expect(inserted(TEXT, 'steps/3/repeat', 0, 'repeat:\n  - {wait: 1}\ntimes: 2')).toContain(
      '  - repeat:\n      - repeat:\n          - {wait: 1}\n        times: 2\n      - {wait: 3}\n',
    );
  });
  it('go one place, into the one before, and out', () => {
    const { list } = blocksOf(TEXT);
    const to = (path: string, way: 'up' | 'down' | 'into' | 'out') => list && destination(list, path, way);
    expect(to('steps/1', 'up')).toEqual({ list: 'steps', at: 0 });
    expect(to('steps/1', 'down')).toEqual({ list: 'steps', at: 3 });
    expect([to('steps/0', 'up'), to('steps/4', 'down'), to('steps/1', 'into'), to('steps/1', 'out')]).toEqual(
      Array(4).fill(null),
    );
    expect(to('steps/3', 'into')).toEqual({ list: 'steps/2/parallel', at: 2 });
    expect(to('steps/2/parallel/1/1', 'out')).toEqual({ list: 'steps/2/parallel', at: 2 });
    expect(to('steps/3/repeat/0', 'out')).toEqual({ list: 'steps', at: 4 });
  });
  it('refuse what leaves no list, and a step in itself', () => {
    expect(removed('steps:\n  - {wait: 1}\n', 'steps/0')).toBeNull();
    expect(moved(TEXT, 'steps/2', 'steps/2/parallel', 0)).toBeNull();
    expect(moved('steps:\n  - if: true\n    then: {wait: 1}\n', 'steps/0/then', 'steps', 0)).toBeNull();
  });
  it('put the first step below a key, and into empty brackets', () => {
    expect(inserted('steps: # all\n# end\n', 'steps', 0, '{wait: 1}')).toBe('steps: # all\n  - {wait: 1}\n# end\n');
    expect(inserted('steps: []', 'steps', 0, 'repeat:\n  - {wait: 1}\ntimes: 2')).toBe(
      'steps: [{repeat: [{wait: 1}], times: 2}]',
    );
  });
});

describe('steps in brackets', () => {
  it('are moved, removed and put in as parts of their line', () => {
    const at = (edited: string | null) => edited?.split('\n').find((line) => line.includes('parallel: ['));
    expect(at(removed(TEXT, 'steps/4/parallel/0'))).toBe('  - parallel: [{wait: 6}]');
    expect(at(inserted(TEXT, 'steps/4/parallel', 1, '{wait: 9}'))).toBe(
      '  - parallel: [{wait: 5}, {wait: 9}, {wait: 6}]',
    );
    expect(at(inserted(TEXT, 'steps/4/parallel', 2, 'sequence:\n  - {wait: 9}'))).toBe(
      '  - parallel: [{wait: 5}, {wait: 6}, {sequence: [{wait: 9}]}]',
    );
    expect(at(moved(TEXT, 'steps/4/parallel/1', 'steps/4/parallel', 0))).toBe('  - parallel: [{wait: 6}, {wait: 5}]');
    expect(moved(TEXT, 'steps/4/parallel/0', 'steps', 5)).toContain('  - parallel: [{wait: 6}]\n  - {wait: 5}\n');
    expect(at(moved(TEXT, 'steps/3/repeat/0', 'steps/4/parallel', 0))).toContain('[{wait: 3}, {wait: 5}, {wait: 6}]');
  });
  it('are steps of lines before, where no comment is lost', () => {
    const text = 'steps:\n  - task: a\n    skill: work\n  - task: b # two\n  - parallel: [{wait: 1}, {wait: 2}]\n';
    expect(moved(text, 'steps/0', 'steps/2/parallel', 2)).toContain('{wait: 2}, {task: a, skill: work}]');
    expect(moved(text, 'steps/1', 'steps/2/parallel', 2)).toBeNull();
  });
  it('keep their lines where they have several', () => {
    const text = 'steps:\n  - parallel: [\n      {wait: 1},\n      {task: a,  # who\n       skill: b},\n    ]\n';
    const [, , branch] = blocks(text);
    expect([branch?.path, branch?.fixed]).toEqual(['steps/0/parallel/1', '']);
    expect(moved(text, 'steps/0/parallel/1', 'steps/0/parallel', 0)).toBe(
      'steps:\n  - parallel: [\n      {task: a,  # who\n       skill: b},\n      {wait: 1},\n    ]\n',
    );
    expect(moved(text, 'steps/0/parallel/1', 'steps', 1)).toBe(
      'steps:\n  - parallel: [\n      {wait: 1},\n    ]\n  - {task: a,  # who\n    skill: b}\n',
    );
  });
  it('stay where nobody can tell whose a comment is, where they stand alone, and where a mark is theirs', () => {
    const fixed = (text: string) => blocks(text).map((one) => one.fixed);
    expect(fixed('steps: [{wait: 1}, # one\n  {wait: 2}]')).toEqual(['comments', 'comments']);
    expect(fixed('steps: {wait: 1}')).toEqual(['alone']);
    expect(fixed('steps:\n  - &a {wait: 1}\n  - {wait: 2}')).toEqual(['marked', 'marked']);
    expect(inserted('steps: [{wait: 1}, # one\n  {wait: 2}]', 'steps', 0, '{wait: 3}')).toBeNull();
  });
});

/** Each step is found after an edit where `pathThrough` says, and one that was taken away is not looked for. */
function follows(text: string, after: string, edit: BlockEdit): void {
  const there = new Map(blocks(after).map((one) => [one.path, `${one.kind} ${one.title} ${one.detail}`]));
  for (const one of blocks(text)) {
    const path = pathThrough(one.path, edit);
    if (path !== null) expect(there.get(path)).toBe(`${one.kind} ${one.title} ${one.detail}`);
    else expect(one.path.startsWith(edit.kind === 'remove' ? edit.path : '-')).toBe(true);
  }
}

describe('whatever is moved, removed or inserted', () => {
  // Each edit of each text, and then each edit of what came of it.
  const texts = [
    TEXT,
    TEXT.trimEnd(),
    TEXT.replace('  # the end\n', ''),
    'steps:\n- {wait: 1} # a\n- repeat:\n  - {wait: 2} # b\n  # c\n  - wait: 3\n    # d\n  times: 2\n# e\n- {wait: 4}',
  ];
  const second = texts.flatMap((text) =>
    blocks(text).flatMap((one) => lists(text).flatMap((list) => moved(text, one.path, list.path, 0) ?? [])),
  );
  it.each([...texts, ...[...new Set(second)].filter((_, at) => at % 45 === 0)])('leaves all else as it was', (text) => {
    for (const one of blocks(text)) {
      for (const list of lists(text)) {
        for (let at = 0; at <= list.blocks.length; at += 1) {
          const after = moved(text, one.path, list.path, at);
          if (after === null) continue;
          expect(parseDocument(after).errors).toEqual([]);
          const now = blocks(after).find((other) => other.path === pathAfter(one.path, list.path, at));
          if (after !== text) expect([now?.kind, now?.title]).toEqual([one.kind, one.title]);
          follows(text, after, { kind: 'move', path: one.path, list: list.path, at });
          expect(comments(after)).toEqual(comments(text));
          expect([...stepsOf(after)].sort()).toEqual([...stepsOf(text)].sort());
          expect(words(after)).toEqual(words(text));
        }
      }
      const without = removed(text, one.path);
      if (without !== null) {
        expect(parseDocument(without).errors).toEqual([]);
        expect(editBetween(text, without)?.insert).toBe('');
        expect(blocks(without)).toHaveLength(blocks(text).length - 1 - one.lists.flatMap(all).length);
        follows(text, without, { kind: 'remove', path: one.path });
      }
    }
    for (const list of lists(text)) {
      for (let at = 0; at <= list.blocks.length; at += 1) {
        const after = inserted(text, list.path, at, '{task: new, skill: work}');
        if (after === null) continue;
        expect(parseDocument(after).errors).toEqual([]);
        const edit = editBetween(text, after);
        expect(edit?.to).toBe(edit?.from);
        expect(words(edit?.insert ?? '')).toEqual(['new', 'skill:', 'task:', 'work']);
        const found = lists(after).find((other) => other.path === list.path);
        expect(found?.blocks[at]?.title).toBe('new');
        follows(text, after, { kind: 'insert', list: list.path, at, step: '' });
      }
    }
  });
});

describe('freeTask', () => {
  it('is a name that there is not', () => {
    expect([freeTask(TEXT, 'one'), freeTask(TEXT, 'pick up'), freeTask(TEXT, '3')]).toEqual(['one_2', 'pick_up', '_3']);
  });
});
