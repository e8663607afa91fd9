import { describe, expect, it } from 'vitest';
import { formatNumber, formatValue, isNever, numberOf, qualityOf, statusName } from './value';

describe('the quality of a StatusCode', () => {
  it.each([
    [0, 'good'],
    [0x00000400, 'good'],
    [0x40900000, 'uncertain'],
    [0x80310000, 'bad'],
    [0xffffffff, 'bad'],
    // As a number that a reader took for signed.
    [0x80310000 | 0, 'bad'],
  ])('of %i is %s', (status, quality) => expect(qualityOf(status)).toBe(quality));

  it('has the name of the code without its info bits', () => {
    expect(statusName(0)).toBe('Good');
    expect(statusName(0x80310400)).toBe('BadNoCommunication');
    expect(statusName(0x80ab0000)).toBe('0x80AB0000');
  });

  it('tells what has never come', () => {
    expect(isNever({ v: null, s: 0x80320000, t: null })).toBe(true);
    expect(isNever({ v: 1, s: 0x80310000, t: null })).toBe(false);
  });
});

describe('a number', () => {
  it.each([
    [0, '0'],
    [-3, '−3'],
    [0.1 + 0.2, '0.3'],
    [21.45678912, '21.45679'],
    [-1e-9, '−1.000e−9'],
    [123456789, '123456789'],
    [1e21, '1.000e+21'],
    [Infinity, '∞'],
    [NaN, 'NaN'],
  ])('%d is %s', (value, text) => expect(formatNumber(value)).toBe(text));

  it('has fewer digits where there is little room', () => {
    expect(formatValue(87.49654, 5)).toBe('87.497');
    expect(formatValue(123456.78, 5)).toBe('123460');
    expect(formatValue(123456, 5)).toBe('123456');
  });
});

describe('a value', () => {
  it.each([
    [null, '—'],
    [true, 'true'],
    [[1, 2.5], '[1, 2.5]'],
    [{ int: '18446744073709551615' }, '18446744073709551615'],
    [{ float: 'NaN' }, 'NaN'],
    [{ float: '-Infinity' }, '−∞'],
    [{ bytes: 12 }, '12 bytes'],
    [{ x: 1, y: { z: 'a' } }, '{x: 1, y: {z: a}}'],
    ['<b>', '<b>'],
    [{ text: 1000000, first: 'a\u202eb' }, '1000000 characters, beginning a\\u202eb'],
    [{ array: 5000, first: [1, 2] }, '5000 elements, the first [1, 2]'],
    [{ text: 1, first: 2 }, '{text: 1, first: 2}'],
  ])('%j is %s', (value, text) => expect(formatValue(value)).toBe(text));

  it('is a number where it stands for one', () => {
    expect(numberOf({ int: '9007199254740993' })).toBeCloseTo(9007199254740993);
    expect(numberOf({ float: 'Infinity' })).toBe(Infinity);
    expect(numberOf('12')).toBeNull();
  });
});
