import { expect, it } from 'vitest';
import { FURTHEST, asked, judged, pairsOf, same, stepOf, valueOf } from './judgements';

const CRITERIA = ['battery', 'distance', 'load'];
const [first, , last] = pairsOf(CRITERIA);

it('makes each pair once', () => {
  expect(pairsOf(CRITERIA).map((pair) => pair.name)).toEqual(['battery/distance', 'battery/load', 'distance/load']);
  expect(pairsOf(['one'])).toEqual([]);
});

it('reads a pair whichever stands first', () => {
  expect(judged({ 'battery/distance': 3 }, first!)).toBe(3);
  expect(judged({ 'distance/battery': 4 }, first!)).toBe(0.25);
  expect(judged({}, last!)).toBe(1);
});

it('goes from each step to its value and back', () => {
  for (let step = -FURTHEST; step <= FURTHEST; step += 1) expect(stepOf(valueOf(step))).toBe(step);
  expect([valueOf(0), valueOf(8), valueOf(-8)]).toEqual([1, 9, 1 / 9]);
  expect([stepOf(100), stepOf(0.001)]).toEqual([8, -8]);
});

it('asks for all pairs, and knows what has changed', () => {
  expect(asked(CRITERIA, { 'distance/battery': 2 })).toEqual({
    'battery/distance': 0.5,
    'battery/load': 1,
    'distance/load': 1,
  });
  expect(same(CRITERIA, { 'battery/distance': 2 }, { 'distance/battery': 0.5 })).toBe(true);
  expect(same(CRITERIA, { 'battery/distance': 2 }, {})).toBe(false);
});
