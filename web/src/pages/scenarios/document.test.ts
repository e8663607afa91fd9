import { describe, expect, it } from 'vitest';
import { parseDocument } from 'yaml';
import {
  type Block,
  blocksOf,
  freeTask,
  inserted,
  type List,
  moved,
  pathAfter,
  removed,
  destination,
} from './document';

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
const comments = (text: string) => [...text.matchAll(/#[^\n]*/g)].map((one) => one[0]).sort();
const stepsOf = (text: string) =>
  blocks(text)
    .filter((one) => !one.lists.length)
    .map((one) => `${one.kind} ${one.title}`);
const trimmedLines = (text: string) => text.split('\n').map((line) => line.trim());

describe('blocksOf', () => {
  it('tells the tree', () => {
    expect(blocks(TEXT).map((one) => [one.path, one.kind, one.title, one.detail, one.movable])).toEqual([
      ['steps/0', 'task', 'one', 'work → left', true],
      ['steps/1', 'task', 'two', 'work → weld ⇠ one', true],
      ['steps/2', 'parallel', '', '', true],
      ['steps/2/parallel/0', 'task', 'three', 'work → left', true],
      ['steps/2/parallel/1', 'branch', '', '', true],
      ['steps/2/parallel/1/0', 'wait', '1', '', false],
      ['steps/2/parallel/1/1', 'wait', '2', '', true],
      ['steps/3', 'repeat', '', '× 2', true],
      ['steps/3/repeat/0', 'wait', '3', '', true],
      ['steps/3/repeat/1', 'wait', '4', '', true],
      ['steps/4', 'parallel', '', '', true],
      ['steps/4/parallel/0', 'wait', '5', '', false],
      ['steps/4/parallel/1', 'wait', '6', '', false],
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
  it('refuse what leaves no list, and steps in brackets', () => {
    expect(removed('steps:\n  - {wait: 1}\n', 'steps/0')).toBeNull();
    expect(moved(TEXT, 'steps/4/parallel/0', 'steps', 0)).toBeNull();
    expect(moved(TEXT, 'steps/2', 'steps/2/parallel', 0)).toBeNull();
    expect(inserted(TEXT, 'steps/4/parallel', 0, '{wait: 1}')).toBeNull();
    expect(removed(TEXT, 'steps/2/parallel/1/0')).toBeNull();
  });
});

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
  it.each([...texts, ...[...new Set(second)].filter((_, at) => at % 9 === 0)])('leaves all else as it was', (text) => {
    for (const one of blocks(text)) {
      for (const list of lists(text)) {
        for (let at = 0; at <= list.blocks.length; at += 1) {
          const after = moved(text, one.path, list.path, at);
          if (after === null) continue;
          expect(parseDocument(after).errors).toEqual([]);
          const now = blocks(after).find((other) => other.path === pathAfter(one.path, list.path, at));
          if (after !== text) expect([now?.kind, now?.title]).toEqual([one.kind, one.title]);
          expect(comments(after)).toEqual(comments(text));
          expect([...stepsOf(after)].sort()).toEqual([...stepsOf(text)].sort());
          // The lines are the same ones, in another order and indentation.
          expect(trimmedLines(after).filter(Boolean).sort()).toEqual(trimmedLines(text).filter(Boolean).sort());
        }
      }
      const without = removed(text, one.path);
      if (without !== null) {
        expect(parseDocument(without).errors).toEqual([]);
        expect(blocks(without)).toHaveLength(blocks(text).length - 1 - one.lists.flatMap(all).length);
      }
    }
    for (const list of lists(text)) {
      for (let at = 0; at <= list.blocks.length; at += 1) {
        const after = inserted(text, list.path, at, '{task: new, skill: work}');
        if (after === null) continue;
        expect(parseDocument(after).errors).toEqual([]);
        expect(after.replace(/\n? *- \{task: new, skill: work\}\n/, '\n').trim()).toBe(text.trim());
        const found = lists(after).find((other) => other.path === list.path);
        expect(found?.blocks[at]?.title).toBe('new');
      }
    }
  });
});

describe('freeTask', () => {
  it('is a name that there is not', () => {
    expect([freeTask(TEXT, 'one'), freeTask(TEXT, 'pick up'), freeTask(TEXT, '3')]).toEqual(['one_2', 'pick_up', '_3']);
  });
});
