import { describe, expect, it } from 'vitest';
import { around, difference } from './difference';

describe('difference', () => {
  it('gives back both texts', () => {
    for (const [mine, theirs] of [
      ['a\nb\nc', 'a\nx\nc\nd'],
      ['', 'a'],
      ['a\na\na', 'a\na'],
      ['x', 'x'],
      ['a\nb', 'b\na'],
    ] as const) {
      const lines = difference(mine, theirs);
      const of = (other: string) => lines.filter((line) => line.kind !== other).map((line) => line.text);
      expect(of('theirs').join('\n')).toBe(mine);
      expect(of('mine').join('\n')).toBe(theirs);
    }
  });
  it('tells only the line that is another', () => {
    const lines = difference('a\nb\nc', 'a\nx\nc');
    expect(lines.map((line) => line.kind)).toEqual(['same', 'mine', 'theirs', 'same']);
  });
  it('leaves out what is far from it', () => {
    const text = (middle: string) => [...'abcdefgh'].join('\n') + `\n${middle}`;
    expect(around(difference(text('1'), text('2')), 1)).toEqual([
      null,
      { kind: 'same', text: 'h' },
      { kind: 'mine', text: '1' },
      { kind: 'theirs', text: '2' },
    ]);
  });
});
