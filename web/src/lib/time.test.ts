import { describe, expect, it } from 'vitest';
import { ageOf, formatAge, formatLength, formatTime, LISTED_NOW_S } from './time';

describe('an age', () => {
  it.each([
    [-10, 'in 10 s'],
    [-1.5, 'now'],
    [0.4, 'now'],
    [2.9, 'now'],
    [3, '3 s'],
    [8.9, '8 s'],
    [60, '1 min'],
    [7199, '1 h'],
    [200000, '2 d'],
  ])('of %d s is %s', (seconds, text) => expect(formatAge(seconds)).toBe(text));

  it('of a robot in a list is now while it tells something each second', () => {
    expect(formatAge(4.9, LISTED_NOW_S)).toBe('now');
    expect(formatAge(5, LISTED_NOW_S)).toBe('5 s');
    expect(formatAge(-10, LISTED_NOW_S)).toBe('in 10 s');
  });

  it('is that of a time', () => {
    expect(ageOf('2026-11-23T22:00:00Z', Date.UTC(2026, 10, 23, 22, 0, 8))).toBe(8);
    expect(ageOf(null, 0)).toBeNull();
    expect(ageOf('yesterday', 0)).toBeNull();
  });
});

describe('a length', () => {
  it.each([
    [0.25, '250 ms'],
    [59.9, '59 s'],
    [60.5, '1 min'],
    [200, '3 min 20 s'],
    [3659, '1 h'],
    [5000, '1 h 23 min'],
    [200000, '2 d 7 h'],
  ])('of %d s is %s', (seconds, text) => expect(formatLength(seconds)).toBe(text));
});

describe('a time', () => {
  it('has its date when it is not of today', () => {
    const now = new Date(2026, 10, 23, 22, 0, 0).getTime();
    expect(formatTime(new Date(2026, 10, 23, 9, 5, 7, 40).toISOString(), now, true)).toBe('09:05:07.040');
    expect(formatTime(new Date(2026, 10, 22, 9, 5, 7).toISOString(), now)).toBe('2026-11-22 09:05:07');
    expect(formatTime('x', now)).toBe('—');
    // The first and the last moment of a day, asked for on that day and on the next.
    const [first, last] = [new Date(2026, 10, 22, 0, 0, 0), new Date(2026, 10, 22, 23, 59, 59, 999)];
    expect(formatTime(first.toISOString(), last.getTime())).toBe('00:00:00');
    expect(formatTime(last.toISOString(), first.getTime())).toBe('23:59:59');
    expect(formatTime(last.toISOString(), last.getTime() + 1)).toBe('2026-11-22 23:59:59');
    expect(formatTime(new Date(last.getTime() + 1).toISOString(), last.getTime())).toBe('2026-11-23 00:00:00');
  });
});
