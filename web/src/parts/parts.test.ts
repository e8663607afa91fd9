import { describe, expect, it } from 'vitest';
import { type Argument, initialText, parseArgument } from './arguments';
import { linePath } from './line';
import { sorted } from './sorting';
import { windowOf } from './window';

describe('an argument of a form', () => {
  const of = (type: string, more: Partial<Argument> = {}): Argument => ({ name: 'a', type, ...more });

  it.each<[Argument, string, unknown]>([
    [of('Double'), '1,5', { value: 1.5 }],
    [of('Double'), '−2', { value: -2 }],
    [of('Double', { low: 0, high: 60 }), '61', { error: 'Give 0 to 60.' }],
    [of('Double', { low: 1 }), '0', { error: 'Give 1 or more.' }],
    [of('UInt16', { high: 9 }), '10', { error: 'Give 0 to 9.' }],
    [of('Byte'), '256', { error: 'Give 0 to 255.' }],
    [of('Int32'), '1.5', { error: 'Give a whole number.' }],
    [of('Int32'), '', { error: 'Give a value.' }],
    [of('Double'), 'NaN', { error: 'Give a number.' }],
    [of('Boolean'), 'true', { value: true }],
    [of('String'), '', { value: '' }],
    [of('Double[]'), '[1, 2.5]', { value: [1, 2.5] }],
    [of('Double[]'), '1\n2', { value: [1, 2] }],
    [of('Double[]'), '["1", "2,5"]', { value: [1, 2.5] }],
    [of('Double[]', { low: 0, high: 2 }), '["1", "7"]', { error: 'Element 2: Give 0 to 2.' }],
    [of('Double[]'), '[""]', { error: 'Element 1: Give a value.' }],
    [of('Boolean[]'), '[true, false]', { value: [true, false] }],
    [of('Int32[]', { names: { '7': 'left' } }), '[7]', { value: [7] }],
    [of('String[]'), '["a, b", "c"]', { value: ['a, b', 'c'] }],
    [of('Pose'), '{"x": 1}', { value: { x: 1 } }],
    [of('Pose'), '', { error: 'Give a value.' }],
    [of('Double[]'), '', { value: [] }],
    [of('Byte[]'), '1, 300', { error: 'Element 2: Give 0 to 255.' }],
    [of('String[]'), '["a", "b"]', { value: ['a', 'b'] }],
    [of('Int32', { names: { '7': 'left' } }), '7', { value: 7 }],
    [of('Int32', { names: { '7': 'left' } }), '', { error: 'Give a value.' }],
    [of('Int32', { names: { '7': 'left' } }), 'toString', { error: 'Give a value.' }],
  ])('%j of %j is %j', (argument, text, parsed) => expect(parseArgument(argument, text)).toEqual(parsed));

  it('begins with its default', () => {
    expect(initialText(of('Double', { default: 0 }))).toBe('0');
    expect(initialText(of('String', { default: 'weld' }))).toBe('weld');
    expect(initialText(of('Boolean'))).toBe('false');
    expect(initialText(of('Pose', { default: 'x' }))).toBe('"x"');
    expect(parseArgument(of('Pose'), '{x')).toEqual({ error: expect.stringMatching(/^Give JSON: /) as string });
    expect(initialText(of('Int32', { default: 7, names: { '7': 'left' } }))).toBe('7');
    const list = of('Double[]', { default: [1, 2] });
    expect(parseArgument(list, initialText(list))).toEqual({ value: [1, 2] });
  });
});

describe('a long list', () => {
  it('draws what can be seen, and some around it', () => {
    expect(windowOf(1000, 32, 0, 320)).toEqual({ first: 0, end: 18 });
    expect(windowOf(1000, 32, 3200, 320)).toEqual({ first: 92, end: 118 });
    expect(windowOf(10, 32, 0, 3200)).toEqual({ first: 0, end: 10 });
    expect(windowOf(1000, 100, 1000, 300, 3)).toEqual({ first: 6, end: 63 });
    // Scrolled down when the list became short.
    expect(windowOf(3, 32, 9999, 320).end).toBe(3);
    expect(windowOf(0, 32, 0, 320)).toEqual({ first: 0, end: 0 });
  });

  it('is sorted as people count, what says nothing last', () => {
    const rows = ['r10', 'r2', null, 'R1'];
    expect(sorted(rows, (row) => row, false)).toEqual(['R1', 'r2', 'r10', null]);
    expect(sorted(rows, (row) => row, true)).toEqual(['r10', 'r2', 'R1', null]);
  });
});

describe('a line', () => {
  it('has gaps where there is no number', () => {
    expect(linePath([0, 1, null, 1], 32, 12)).toBe('M1.0 10.0h.1L11.0 2.0M31.0 2.0h.1');
    expect(linePath([null, NaN], 32, 12)).toBe('');
  });
});
