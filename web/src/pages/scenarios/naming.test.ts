import { describe, expect, it } from 'vitest';
import { editBetween } from './edits';
import { freeName, nameOf, renamed } from './naming';

describe('names', () => {
  it('are read and changed without another sign', () => {
    const text = '# head\nversion: 1\nname:  "a"  # mine\nsteps:\n  - {task: name}\n';
    expect(nameOf(text)).toBe('a');
    expect(renamed(text, 'b')).toBe('# head\nversion: 1\nname:  b  # mine\nsteps:\n  - {task: name}\n');
    expect(nameOf(renamed('version: 1\n', 'c'))).toBe('c');
  });
  it('are new ones', () => {
    expect(freeName('a', (name) => name === 'a' || name === 'a_2')).toBe('a_3');
  });
});

describe('editBetween', () => {
  it('is the smallest one that makes the other text', () => {
    for (const [before, after] of [
      ['abc', 'abXc'],
      ['aaa', 'aa'],
      ['', 'x'],
      ['xyz', ''],
      ['ab', 'ba'],
    ] as const) {
      const edit = editBetween(before, after);
      expect(edit && before.slice(0, edit.from) + edit.insert + before.slice(edit.to)).toBe(after);
    }
    expect(editBetween('a', 'a')).toBeNull();
    expect(editBetween('one two three', 'one 2 three')).toEqual({ from: 4, to: 7, insert: '2' });
  });
});
