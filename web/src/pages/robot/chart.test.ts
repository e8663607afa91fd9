import { describe, expect, it } from 'vitest';
import { aligned, courseOf, heldAt, MOST_LINES, panelsOf, parseLines, tableTimes, toggled } from './chart';
import { History } from './history';

function history(...points: [number, number | null][]): History {
  const made = new History();
  for (const [at, value] of points) made.add(at, value);
  return made;
}

describe('a chart', () => {
  const speed = history([1000, 5], [3000, null], [4000, 7]);
  const lift = history([2000, 1]);

  it('has common times, holds numbers, and has gaps from where they end', () => {
    expect(aligned([speed, lift], 0, 5000)).toEqual([
      [0, 1, 2, 2.999, 3, 4, 5],
      [null, 5, 5, 5, null, 7, 7],
      [null, null, 1, 1, 1, 1, 1],
    ]);
    // What held before it begins.
    expect(aligned([speed], 1500, 2500)).toEqual([
      [1.5, 2.5],
      [5, 5],
    ]);
    expect(aligned([], 0, 1000)).toEqual([[0, 1]]);
  });

  it('is told in words', () => {
    expect(courseOf(speed, 0, 5000)).toEqual({ now: 7, least: 5, greatest: 7 });
    expect(courseOf(speed, 0, 3500)).toEqual({ now: null, least: 5, greatest: 5 });
    expect(courseOf(history(), 0, 3500)).toEqual({ now: null, least: null, greatest: null });
    expect(heldAt(speed, [500, 1000, 3500, 9000])).toEqual([null, 5, null, 7]);
  });

  it('has a table whose rows stay', () => {
    const times = tableTimes(61_234, 60_000);
    expect([times[0], times[1], times.length]).toEqual([60_000, 55_000, 12]);
    expect(tableTimes(64_999, 60_000)).toEqual(times);
  });

  it('has an axis for each unit, and a stroke for each line', () => {
    const line = (node: string, unit: string) => ({ node, name: node, unit, history: history() });
    const panels = panelsOf([line('a', 'm'), line('b', 'V'), line('c', 'm')]);
    expect(panels.map((one) => [one.unit, one.lines.map(({ line, place }) => line.node + place)])).toEqual([
      ['m', ['a0', 'c2']],
      ['V', ['b1']],
    ]);
  });

  it('has lines that the address names, and not too many', () => {
    const many = Array.from({ length: MOST_LINES + 2 }, (_, n) => `ns=2;i=${n}`);
    expect(parseLines(JSON.stringify(many))).toHaveLength(MOST_LINES);
    expect(parseLines('[')).toEqual([]);
    expect(toggled(['a', 'b'], 'a')).toEqual(['b']);
    expect(toggled(many.slice(0, MOST_LINES), 'x').at(-1)).toBe('x');
    expect(toggled(many.slice(0, MOST_LINES), 'x')).toHaveLength(MOST_LINES);
  });

  it('can be stopped: a copy does not go on', () => {
    const line = history([1000, 5], [3000, null]);
    const copy = line.copy();
    line.add(6000, 9);
    expect(copy.times).toEqual([1000, 3000]);
  });
});
