import { describe, expect, it } from 'vitest';
import type { Robot } from './robots';
import { agesOf, bridgesOf, countsOf, linesOf, sameRows, selected, type Wish, wishOf } from './selection';

const robot = (name: string, state: Robot['state']['v'], more: Partial<Robot> = {}): Robot => ({
  name,
  state: { v: state, s: 0, t: null },
  ...more,
});

const FLEET = [
  robot('arm10', 'busy', {
    bridge: 'ros1',
    task: 'place of R-2',
    capacities: ['grab'],
    updated: '2026-11-23T22:00:01Z',
  }),
  robot('arm2', 'idle', {
    bridge: 'ros1',
    capacities: ['grab', 'mobile'],
    quality: 0,
    faults: 1,
    updated: '2026-11-23T22:00:03Z',
  }),
  robot('drone', 'faulted', { bridge: 'ros2', fault: 'Motor too hot', quality: 0x80310000, capacities: ['fly'] }),
  robot('Belt', 'offline', { held: { by: 'otto', reason: 'maintenance' } }),
  // Its state is told, but not with Good quality.
  { name: 'shy', state: { v: 'idle', s: 0x80310000, t: null } } satisfies Robot,
];

const wish = (given: Partial<Wish> = {}): Wish => ({ ...wishOf(() => ''), ...given });
const LATER = Date.parse('2026-11-23T23:00:00Z');
const ages = (nowMs: number, before = new Map<string, number | null>()) => agesOf(FLEET, nowMs, before);
const names = (given: Partial<Wish>, nowMs = LATER) =>
  selected(FLEET, wish(given), ages(nowMs)).map((row) => row.robot.name);

describe('robots', () => {
  it.each<[Partial<Wish>, string[]]>([
    [{}, ['arm2', 'arm10', 'Belt', 'drone', 'shy']],
    [{ down: true }, ['shy', 'drone', 'Belt', 'arm10', 'arm2']],
    [{ text: 'HOT drone' }, ['drone']],
    [{ text: 'maint' }, ['Belt']],
    [{ text: 'arm fly' }, []],
    [{ state: 'idle' }, ['arm2']],
    [{ state: 'unknown' }, ['shy']],
    [{ state: 'held' }, ['Belt']],
    // Also one that is idle meanwhile.
    [{ state: 'fault' }, ['arm2', 'drone']],
    [{ bridge: 'ros1' }, ['arm2', 'arm10']],
    [{ quality: 'good' }, ['arm2']],
    // What is not known to be good is not.
    [{ quality: 'not-good', bridge: 'ros1' }, ['arm10']],
    [{ sort: 'state' }, ['drone', 'Belt', 'shy', 'arm10', 'arm2']],
    [{ sort: 'updated' }, ['arm10', 'arm2', 'Belt', 'drone', 'shy']],
    // Those that nothing is known of are last either way.
    [{ sort: 'updated', down: true }, ['arm2', 'arm10', 'Belt', 'drone', 'shy']],
    [{ sort: 'task', down: true }, ['arm10', 'arm2', 'Belt', 'drone', 'shy']],
  ])('as wished for by %j', (given, expected) => expect(names(given)).toEqual(expected));

  it('keep their places by age while all of them are fresh', () => {
    const nowMs = Date.parse('2026-11-23T22:00:10.5Z');
    expect(names({ sort: 'updated' }, nowMs)).toEqual(['arm2', 'arm10', 'Belt', 'drone', 'shy']);
    expect(names({ sort: 'updated', down: true }, nowMs)).toEqual(['arm2', 'arm10', 'Belt', 'drone', 'shy']);
    // The age of arm10 is 10 s then.
    expect(names({ sort: 'updated' }, nowMs + 500)).toEqual(['arm10', 'arm2', 'Belt', 'drone', 'shy']);
    expect(names({ sort: 'updated', down: true }, nowMs + 500)).toEqual(['arm2', 'arm10', 'Belt', 'drone', 'shy']);
    const before = ages(nowMs);
    expect(agesOf(FLEET, nowMs, before)).toBe(before);
    expect(agesOf(FLEET, nowMs + 500, before)).not.toBe(before);
    expect(agesOf(FLEET.slice(0, 4), nowMs, before)).not.toBe(before);
    expect(agesOf([robot('arm', 'idle', { updated: 'not a time' })], nowMs, before)).toEqual(new Map([['arm', null]]));
  });

  it.each<Partial<Wish>>([{}, { group: 'capacity' }, { group: 'bridge', sort: 'updated' }])(
    'have the same rows again, wished for by %j',
    (given) => {
      const before = selected(FLEET, wish(given), ages(LATER));
      expect(sameRows(before, selected(FLEET, wish(given), ages(LATER)))).toBe(before);
      const fewer = selected(FLEET.slice(1), wish(given), ages(LATER));
      expect(sameRows(before, fewer)).toBe(fewer);
      const other = selected(
        FLEET.map((one) => (one.name === 'drone' ? { ...one } : one)),
        wish(given),
        ages(LATER),
      );
      expect(sameRows(before, other)).toBe(other);
      expect(other.filter((row, place) => row !== before[place]).map((row) => row.robot.name)).toEqual(['drone']);
    },
  );

  it('stand in groups, each in all of its own', () => {
    expect(selected(FLEET, wish({ group: 'capacity' })).map((row) => row.key)).toEqual([
      '/Belt',
      '/shy',
      'fly/drone',
      'grab/arm2',
      'grab/arm10',
      'mobile/arm2',
    ]);
    expect(selected(FLEET, wish({ group: 'state' })).map((row) => row.group)).toEqual([
      'faulted',
      'offline',
      'unknown',
      'busy',
      'idle',
    ]);
  });

  it('stand in groups whose names differ by case alone, each by itself', () => {
    const robots = [robot('a', 'idle', { bridge: 'Hall' }), robot('b', 'idle', { bridge: 'hall' })];
    robots.push(robot('c', 'idle', { bridge: 'Hall' }));
    expect(selected(robots, wish({ group: 'bridge' })).map((row) => row.key)).toEqual(['Hall/a', 'Hall/c', 'hall/b']);
  });

  it('have bridges, which are the same array until there is another', () => {
    const robots = ['one', 'two', 'one'].map((bridge, at) => robot(`r${at}`, 'idle', { bridge }));
    const bridges = bridgesOf([...robots, robot('free', 'idle', { bridge: '' })], []);
    expect(bridges).toEqual(['one', 'two']);
    expect(bridgesOf([...robots].reverse(), bridges)).toBe(bridges);
    expect(bridgesOf(robots.slice(2), bridges)).toEqual(['one']);
    expect(bridgesOf([...robots, robot('r', 'idle', { bridge: 'six' })], bridges)).toEqual(['one', 'six', 'two']);
  });

  it('are counted by what they are known to be', () => {
    expect(countsOf(FLEET)).toEqual({
      all: 5,
      held: 1,
      fault: 2,
      states: { faulted: 1, offline: 1, unknown: 1, busy: 1, idle: 1 },
    });
  });

  it('are wished for by an address, also by one that was typed wrong', () => {
    const address: Record<string, string> = { q: 'arm', state: 'broken', sort: 'size', group: 'bridge', down: '1' };
    expect(wishOf((name) => address[name] ?? '')).toEqual(wish({ text: 'arm', group: 'bridge', down: true }));
  });
});

describe('lines of cards', () => {
  const rows = selected(FLEET, wish());

  it('have as many robots as there is room for', () => {
    const lines = linesOf(rows, 2, false, []);
    expect(lines.map((line) => ('rows' in line ? line.rows.map((row) => row.key) : line.group))).toEqual([
      ['arm2', 'arm10'],
      ['Belt', 'drone'],
      ['shy'],
    ]);
  });

  it('are the same objects where no robot in them has changed', () => {
    const before = linesOf(rows, 2, false, []);
    const changed = FLEET.map((one) => (one.name === 'drone' ? { ...one } : one));
    const after = linesOf(selected(changed, wish()), 2, false, before);
    expect(after).toEqual(before);
    expect(after.map((line, at) => line === before[at])).toEqual([true, false, true]);
    expect(linesOf(rows, 3, false, before)[0]).not.toBe(before[0]);
  });

  it('stand below the heading of their group', () => {
    const grouped = selected(FLEET, wish({ group: 'bridge' }));
    const lines = linesOf(grouped, 2, true, []);
    expect(lines.flatMap((line) => ('group' in line ? [[line.group, line.count]] : []))).toEqual([
      ['', 2],
      ['ros1', 2],
      ['ros2', 1],
    ]);
    expect(linesOf(grouped, 2, true, lines)[0]).toBe(lines[0]);
  });
});
