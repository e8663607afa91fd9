import { describe, expect, it } from 'vitest';
import type { Robot } from '../fleet/robots';
import {
  type Position,
  anchorOf,
  fitted,
  formatHeading,
  formatLength,
  formatMetres,
  gridOf,
  keyed,
  moved,
  niceStep,
  placeLabels,
  seenOf,
  shortName,
  toScreen,
  zoomed,
} from './map';

const size = { width: 800, height: 400 };
const view = { x: 2, y: 1, scale: 50 };
const robot = (name: string): Robot => ({ name, state: { v: 'idle', s: 0, t: null } });
const position = (name: string, more: Partial<Position> = {}): Position => ({
  name,
  x: 1,
  y: 2,
  heading: null,
  s: 0,
  t: null,
  frame: '',
  ...more,
});

describe('what is seen', () => {
  const entries = new Map<string, unknown>([
    ['robot/b', position('b')],
    ['robot/a', position('a', { s: 0x80310000 })],
    ['robot/c', position('c', { x: null })],
    ['place/gate', { name: 'gate', x: 0, y: 0 }],
    ['fleet', {}],
  ]);
  const robots = new Map(['a', 'b', 'c', 'd'].map((name) => [name, robot(name)]));

  it('has robots that say where they are, and names the others', () => {
    const seen = seenOf(entries, robots, true);
    expect(seen.markers.map((one) => [one.name, one.now, one.standing])).toEqual([
      ['a', false, 'idle'],
      ['b', true, 'idle'],
    ]);
    expect(seen.places.map((one) => one.name)).toEqual(['gate']);
    expect(seen.missing).toEqual(['c', 'd']);
  });

  it('tells the fault of a robot that is idle meanwhile', () => {
    const broken = new Map([...robots, ['b', { ...robot('b'), faults: 1, fault: 'lacks mobile' }]]);
    const seen = seenOf(entries, broken, true);
    expect(seen.markers.map((one) => [one.name, one.faulty, one.fault])).toEqual([
      ['a', false, ''],
      ['b', true, 'lacks mobile'],
    ]);
  });

  it('takes nothing for now while the link is away', () => {
    expect(seenOf(entries, robots, false).markers.some((one) => one.now)).toBe(false);
    expect(seenOf(entries, new Map(), true).markers[0]?.standing).toBe('unknown');
  });
});

describe('a view', () => {
  it('has y upwards', () => {
    expect(toScreen(view, size, { x: 2, y: 1 })).toEqual({ x: 400, y: 200 });
    expect(toScreen(view, size, { x: 3, y: 2 })).toEqual({ x: 450, y: 150 });
  });

  it('shows all points with room beside them', () => {
    const points = [
      { x: -3, y: 0 },
      { x: 9, y: 4 },
    ];
    for (const one of points) {
      const at = toScreen(fitted(points, size), size, one);
      expect(at.x).toBeGreaterThanOrEqual(48 - 1e-6);
      expect(at.x).toBeLessThanOrEqual(752 + 1e-6);
      expect(at.y).toBeGreaterThanOrEqual(48 - 1e-6);
      expect(at.y).toBeLessThanOrEqual(352 + 1e-6);
    }
  });

  it('stays while points move a little', () => {
    const a = fitted(
      [
        { x: 0.3, y: 0.2 },
        { x: 9.1, y: 3.2 },
      ],
      size,
    );
    expect(
      fitted(
        [
          { x: 0.4, y: 0.3 },
          { x: 9.3, y: 3.4 },
        ],
        size,
      ),
    ).toEqual(a);
  });

  it('takes one point, none, and tiny windows', () => {
    expect(fitted([], size)).toEqual({ x: 0, y: 0, scale: 50 });
    expect(fitted([{ x: 1e9, y: 0 }], size).scale).toBeGreaterThan(1);
    expect(fitted([{ x: 0, y: 0 }], { width: 0, height: 0 }).scale).toBeGreaterThan(0);
  });

  it('zooms about a point of the screen', () => {
    const point = { x: 5, y: 3 };
    const at = toScreen(view, size, point);
    const after = toScreen(zoomed(view, size, 3, at.x, at.y), size, point);
    expect(after.x).toBeCloseTo(at.x);
    expect(after.y).toBeCloseTo(at.y);
    expect(zoomed(view, size, 1e9).scale).toBe(2000);
  });

  it('is moved by dragging and by keys', () => {
    expect(moved(view, 50, 50)).toEqual({ x: 1, y: 2, scale: 50 });
    expect(keyed(view, size, 'ArrowRight')?.x).toBeCloseTo(3.2);
    expect(keyed(view, size, 'ArrowUp')?.y).toBeCloseTo(2.2);
    expect(keyed(view, size, '+')?.scale).toBeCloseTo(62.5);
    expect(keyed(view, size, 'a')).toBeNull();
  });
});

describe('a grid', () => {
  it('has round numbers', () => {
    expect([0.3, 1, 1.2, 3, 7, 70].map(niceStep)).toEqual([0.5, 1, 2, 5, 10, 100]);
    const grid = gridOf(view, size);
    expect(grid.step).toBe(2);
    expect(grid.xs).toEqual([-6, -4, -2, 0, 2, 4, 6, 8, 10]);
    expect(grid.ys).toEqual([-2, 0, 2, 4]);
  });

  it('has few lines however far one looks', () => {
    expect(gridOf({ x: 1e12, y: 0, scale: 0.001 }, size).xs.length).toBeLessThan(20);
  });
});

describe('texts', () => {
  it('stay within the edges', () => {
    expect([10, 400, 790].map((x) => anchorOf(x, 800))).toEqual(['start', 'middle', 'end']);
    expect(anchorOf(10, 100)).toBe('middle');
  });

  it('are short', () => {
    expect([0.005, 0.5, 2, 5000].map(formatLength)).toEqual(['5 mm', '50 cm', '2 m', '5 km']);
    expect([1.005, -2, -0.001].map(formatMetres)).toEqual(['1.00', '−2.00', '0.00']);
    expect([0, -Math.PI / 2, Math.PI, 7].map(formatHeading)).toEqual(['0°', '270°', '180°', '41°']);
    expect(shortName('a'.repeat(30), 5)).toBe('aaaa…');
    expect(shortName('🤖'.repeat(3), 3)).toBe('🤖🤖🤖');
  });
});

describe('names of places', () => {
  const at = (name: string, x: number, y: number) => ({ name, x, y });
  const gate = at('gate', 400, 200);

  it('stand below where nothing else is', () => {
    expect(placeLabels([gate], [at('arm', 100, 100)], 800)).toEqual([{ x: 0, y: 20, anchor: 'middle' }]);
  });

  it('go out of the way of robots, of their names and of each other', () => {
    // A robot below, whose name is where that of the place would be.
    expect(placeLabels([gate], [at('ridgeback', 400, 240)], 800)).toEqual([{ x: 0, y: -12, anchor: 'middle' }]);
    // One on each of two places beside each other: their names go beside it and below it.
    const two = [gate, at('dock', 405, 200)];
    expect(placeLabels(two, [at('arm', 400, 205)], 800).map((one) => one.anchor)).toEqual(['start', 'middle']);
    // At the edge there is no room to the right.
    expect(placeLabels([at('gate', 796, 200)], [], 800)).toEqual([{ x: 0, y: 20, anchor: 'end' }]);
  });

  it('stand below where there is no free side', () => {
    const around = [-40, -20, 0, 20, 40].flatMap((x) => [-40, 0, 40].map((y) => at('arm', 400 + x, 200 + y)));
    expect(placeLabels([gate], around, 800)).toEqual([{ x: 0, y: 20, anchor: 'middle' }]);
  });
});
