import { describe, expect, it } from 'vitest';
import { type BrowsedNode, type Below, above, isNote, move, pathOf, rowsOf } from './tree';

const node = (id: string, below: number | null = 0): BrowsedNode => ({
  node: id,
  name: id,
  display: id,
  class: 'Object',
  type: null,
  property: false,
  below,
});

const ids = (rows: ReturnType<typeof rowsOf>) => rows.map((row) => (isNote(row) ? row.note : row.path));

describe('rows of a tree', () => {
  const roots = [node('a', 2), node('b')];
  const below = new Map<string, Below>([['a', [node('a1'), node('a2', 1)]]]);

  it('shows what is below an open node after it, with its place among its siblings', () => {
    expect(ids(rowsOf(roots, below, new Set()))).toEqual(['a', 'b']);
    const rows = rowsOf(roots, below, new Set(['a']));
    expect(ids(rows)).toEqual(['a', 'a\na1', 'a\na2', 'b']);
    expect(rows[2]).toMatchObject({ level: 2, position: 2, siblings: 2, expandable: true, open: false });
  });

  it('says that it asks, and why it could not be told', () => {
    expect(ids(rowsOf(roots, new Map([['a', 'asking' as const]]), new Set(['a'])))).toEqual(['a', 'asking', 'b']);
    const failed = { error: 'the server is away' };
    expect(ids(rowsOf(roots, new Map([['a', failed]]), new Set(['a'])))).toEqual(['a', failed, 'b']);
  });

  it('enters no node below itself', () => {
    const around = new Map<string, Below>([
      ['a', [node('b', 1)]],
      ['b', [node('a', 1)]],
    ]);
    const open = new Set(['a', 'a\nb', 'a\nb\na']);
    expect(ids(rowsOf([node('a', 1)], around, open))).toEqual(['a', 'a\nb', 'a\nb\na']);
  });

  it('knows which row stands above another', () => {
    expect(above(pathOf(pathOf('', 'a'), 'a1'))).toBe('a');
    expect(above('a')).toBe('');
  });
});

describe('keys of a tree', () => {
  const rows = rowsOf([node('a', 1), node('b')], new Map([['a', [node('a1')]]]), new Set(['a']));

  it.each([
    ['a', 'ArrowDown', { go: 'a\na1' }],
    ['b', 'ArrowDown', { go: 'b' }],
    ['a', 'ArrowUp', { go: 'a' }],
    ['b', 'Home', { go: 'a' }],
    ['a', 'End', { go: 'b' }],
    ['a', 'ArrowRight', { go: 'a\na1' }],
    ['a', 'ArrowLeft', { close: 'a' }],
    ['a\na1', 'ArrowLeft', { go: 'a' }],
    ['b', 'ArrowLeft', null],
    ['b', 'ArrowRight', null],
    ['gone', 'ArrowDown', { go: 'a' }],
    ['a', 'x', null],
  ])('at %j %s does %j', (current, key, wanted) => {
    expect(move(rows, current, key)).toEqual(wanted);
  });

  it('opens a closed node first', () => {
    expect(move(rowsOf([node('a', 1)], new Map(), new Set()), 'a', 'ArrowRight')).toEqual({ open: 'a' });
  });
});
