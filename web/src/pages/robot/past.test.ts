import { expect, it, vi } from 'vitest';
import { Histories, History } from './history';
import { LONG, Past, SHORT, type Trends } from './past';

const seen = (...points: [number, number | null][]): History => {
  const history = new History();
  for (const [at, value] of points) history.add(at, value);
  return history;
};
const points = (history: History) => history.times.map((at, index) => [at, history.values[index]]);

it('puts what was kept before what was seen', () => {
  const history = seen([1000, 5]);
  history.fill(0, 1000, [-50, 200, 400, 1200], [1, 2, null, 9]);
  // What held at the beginning is there from the beginning on; what the page has seen itself counts.
  expect(points(history)).toEqual([
    [0, 1],
    [200, 2],
    [400, null],
    [1000, 5],
  ]);
});

it('ends in a gap where nothing Good was seen, whatever was kept last', () => {
  const history = new History();
  history.fill(0, 1000, [100], [7]);
  expect(points(history)).toEqual([
    [100, 7],
    [1000, null],
  ]);
});

it('fills the gap of an outage, and leaves what was before its span', () => {
  const history = seen([100, 1], [500, null], [2000, 3]);
  history.fill(400, 2000, [300, 900], [1, 2]);
  expect(points(history)).toEqual([
    [100, 1],
    [900, 2],
    [2000, 3],
  ]);
});

it('is filled again by a longer span, though what was seen is what was kept last', () => {
  const history = seen([1000, 5]);
  history.fill(500, 1000, [600], [5]);
  history.fill(0, 1000, [100, 600], [1, 5]);
  expect(points(history)).toEqual([
    [100, 1],
    [600, 5],
    [1000, 5],
  ]);
});

it('takes the later of two values of one moment', () => {
  const history = new History();
  history.fill(0, 1000, [100, 100], [null, 4]);
  expect(points(history)[0]).toEqual([100, 4]);
});

const told = (lines: Trends['lines']): Trends => ({ now: '2030-01-01T00:00:00Z', lines });

it('asks once for each span and connection, and again after an outage', async () => {
  const ask = vi.fn(async (nodes: readonly string[]) =>
    told(Object.fromEntries(nodes.map((node) => [node, { back: [5000], values: [1], average: false }]))),
  );
  const histories = new Histories();
  const past = new Past(histories, ask);
  await past.want(['a'], SHORT, () => 10_000);
  expect(ask).not.toHaveBeenCalled(); // nothing is live yet
  past.begin(10_000);
  await past.want(['a', 'b'], SHORT, () => 10_000);
  await past.want(['a', 'b'], SHORT, () => 10_000);
  await past.want(['a'], LONG, () => 10_000);
  expect(ask.mock.calls.map(([nodes]) => nodes)).toEqual([['a', 'b'], ['a']]);
  expect(histories.history('b').times[0]).toBe(5000);
  past.lose();
  past.begin(20_000);
  await past.want(['a'], SHORT, () => 20_000);
  expect(ask).toHaveBeenCalledTimes(3);
});

it('leaves a line alone of which nothing was kept, that was refused, or that was lost meanwhile', async () => {
  const histories = new Histories();
  histories.history('a').add(100, 1);
  const before = points(histories.history('a'));
  const empty = new Past(histories, async () => told({ a: { back: [], values: [], average: false } }));
  empty.begin(100);
  await empty.want(['a'], SHORT, () => 100);
  const refused = new Past(histories, () => Promise.reject(new Error('no')));
  refused.begin(100);
  await refused.want(['a'], SHORT, () => 100);
  const lost = new Past(histories, async () => told({ a: { back: [50], values: [9], average: false } }));
  lost.begin(100);
  const waiting = lost.want(['a'], SHORT, () => 100);
  lost.lose();
  await waiting;
  expect(points(histories.history('a'))).toEqual(before);
});
