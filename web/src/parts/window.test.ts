import { expect, it } from 'vitest';
import { linesOf } from './window';

it('draws lines of any height that can be seen, and three around them', () => {
  // A heading of 30 and four lines of 100, ten times.
  const tops = [0];
  for (let at = 0; at < 50; at++) tops.push((tops[at] ?? 0) + (at % 5 ? 100 : 30));
  expect(linesOf(tops, 0, 300)).toEqual({ first: 0, end: 7 });
  expect(linesOf(tops, 430, 100)).toEqual({ first: 2, end: 10 });
  expect(linesOf(tops, 4299, 500).end).toBe(50);
  // Scrolled down when the list became short.
  expect(linesOf([0, 30], 4000, 300)).toEqual({ first: 0, end: 1 });
  expect(linesOf([0], 0, 300)).toEqual({ first: 0, end: 0 });
});
