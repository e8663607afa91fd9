import { describe, expect, it } from 'vitest';
import { type Block, blocksOf, type List } from './document';
import { answered, type BlockEdit, edited, keptList } from './reading';

const TEXT = `name: line
steps:
  - task: a
    skill: work
  - parallel:
      - {task: b, skill: work}
      - - {task: c, skill: work}
        - {wait: 1}
  - if: t > 1
    then:
      - {task: d, skill: work}
`;
const read = (text: string): List => {
  const { list } = blocksOf(text);
  if (!list) throw new Error('it cannot be read');
  return list;
};
const all = (list: List): Block[] =>
  list.blocks.flatMap((block) => [block, ...block.lists.flatMap((below) => all(below))]);

describe('what is asked of the reader', () => {
  it('is answered by number, also where it fails', () => {
    expect(answered({ id: 3, name: 'blocksOf', given: [TEXT] })).toEqual({ id: 3, found: blocksOf(TEXT) });
    const fields = answered({ id: 4, name: 'fieldsOf', given: [TEXT, 'steps/0'] });
    expect('found' in fields && fields.found).toMatchObject({ kind: 'task', line: 3 });
    expect(answered({ id: 5, name: 'fieldsOf', given: [TEXT, 'steps/9'] })).toEqual({ id: 5, found: null });
    expect(answered({ id: 6, name: 'blocksOf', given: [7 as unknown as string] })).toMatchObject({
      id: 6,
      failed: expect.stringContaining('Error') as string,
    });
  });

  it('comes through a message as it is', () => {
    for (const name of ['steps/0', 'steps/1/parallel/1/1']) {
      const answer = answered({ id: 1, name: 'fieldsOf', given: [TEXT, name] });
      expect(structuredClone(answer)).toEqual(answer);
    }
    const answer = answered({ id: 2, name: 'blocksOf', given: [TEXT] });
    expect(structuredClone(answer)).toEqual(answer);
  });
});

describe('an edit of blocks', () => {
  const edits: [BlockEdit, string, string][] = [
    [{ kind: 'move', path: 'steps/0', list: 'steps', at: 2 }, 'steps/1', 'a'],
    [{ kind: 'insert', list: 'steps', at: 1, step: '{task: new, skill: work}' }, 'steps/1', 'new'],
    [{ kind: 'remove', path: 'steps/1' }, 'steps/0', 'a'],
    [{ kind: 'change', path: 'steps/0', changes: [{ key: 'task', value: 'first' }] }, 'steps/0', 'first'],
  ];

  it.each(edits)('is read in one with what is shown after it: %o', (edit, path, name) => {
    const made = edited(TEXT, edit, path);
    expect(made?.blocks).toEqual(blocksOf(made!.text));
    expect(made?.fields?.said.get('task')?.text).toBe(name);
    expect(structuredClone(answered({ id: 7, name: 'edited', given: [TEXT, edit, path] }))).toEqual({
      id: 7,
      found: made,
    });
  });

  it('that cannot be made is none', () => {
    expect(edited(TEXT, { kind: 'move', path: 'steps/1', list: 'steps/1/parallel', at: 0 }, 'steps/1')).toBe(null);
    expect(edited(TEXT, { kind: 'remove', path: 'steps/9' }, 'steps/0')).toBe(null);
  });
});

describe('a list that was read again', () => {
  it('is the one of before where only a comment changed', () => {
    const before = read(TEXT);
    expect(keptList(before, read(TEXT.replace('skill: work\n', 'skill: work  # first\n')))).toBe(before);
    expect(keptList(null, before)).toBe(before);
  });

  it.each<[string, string, string, string[]]>([
    ['a name', 'task: c', 'task: cc', ['steps/1', 'steps/1/parallel/1', 'steps/1/parallel/1/0']],
    ['a condition', 't > 1', 't > 2', ['steps/2']],
    ['the end', '      - {task: d', '      - {task: e', ['steps/2', 'steps/2/then/0']],
    // What is below stands at other lines now.
    [
      'a line',
      '  - parallel:',
      '  # both\n  - parallel:',
      all(read(TEXT))
        .slice(1)
        .map((one) => one.path),
    ],
  ])('has other blocks for %s alone', (_, from, to, expected) => {
    const before = read(TEXT);
    const now = read(TEXT.replace(from, to));
    const kept = keptList(before, now);
    expect(kept).toEqual(now);
    const old = new Set(all(before));
    expect(
      all(kept)
        .filter((one) => !old.has(one))
        .map((one) => one.path),
    ).toEqual(expected);
  });

  it('has steps that were added, and none that were taken away', () => {
    const before = read(TEXT);
    const more = read(`${TEXT}  - {wait: 2}\n`);
    const kept = keptList(before, more);
    expect(kept).toEqual(more);
    expect(kept.blocks.slice(0, 3).map((one, at) => one === before.blocks[at])).toEqual([true, true, true]);
    expect(keptList(kept, before)).toEqual(before);
    expect(keptList(before, read(TEXT.replace('        - {wait: 1}\n', '')))).toEqual(
      read(TEXT.replace('        - {wait: 1}\n', '')),
    );
  });
});
