import { describe, expect, it } from 'vitest';
import type { Robot } from './robots';
import { Roster } from './roster';

const told = (name: string, more: Partial<Robot> = {}): Robot => ({
  name,
  state: { v: 'idle', s: 0, t: '2026-11-23T22:00:00Z' },
  updated: '2026-11-23T22:00:01Z',
  capacities: ['grab'],
  held: null,
  marked: [{ name: 'charge', v: 80, s: 0, t: null }],
  ...more,
});
const fleet = (...robots: Robot[]) => new Map(robots.map((one) => [one.name, one]));

describe('a roster', () => {
  it('is the same while only data come, each second', () => {
    const roster = new Roster();
    const before = roster.of(fleet(told('arm'), told('belt')));
    const later = { updated: '2026-11-23T22:00:02Z', marked: [{ name: 'charge', v: 79, s: 0, t: null }] };
    expect(roster.of(fleet(told('arm', later), told('belt')))).toBe(before);
    expect(before.map((one) => one.name)).toEqual(['arm', 'belt']);
  });

  it.each<Partial<Robot>>([
    { state: { v: 'busy', s: 0, t: '2026-11-23T22:00:00Z' } },
    { state: { v: 'idle', s: 0x80310000, t: '2026-11-23T22:00:00Z' } },
    { quality: 0 },
    { capacities: ['grab', 'fly'] },
    { capacities: undefined },
    { held: { by: 'otto' } },
    { fault: 'Motor too hot' },
    // The height of the cards is by how many there are.
    { marked: [] },
    { updated: undefined, task: 'place' },
  ])('has another robot where %j of it changed, and the same others', (change) => {
    const roster = new Roster();
    const belt = told('belt');
    const before = roster.of(fleet(told('arm'), belt));
    const now = told('arm', change);
    const after = roster.of(fleet(now, told('belt')));
    expect(after).not.toBe(before);
    expect(after[0]).toBe(now);
    expect(after[1]).toBe(belt);
  });

  it('has those that the feed has, in its order', () => {
    const roster = new Roster();
    const [arm, belt, drone] = [told('arm'), told('belt'), told('drone')];
    roster.of(fleet(arm, belt, drone));
    expect(roster.of(fleet(drone, arm))).toEqual([drone, arm]);
    expect(roster.of(fleet(arm, drone))).toEqual([arm, drone]);
    // One that was gone is not what it was before.
    const again = told('belt', { updated: '2026-11-23T23:00:00Z' });
    expect(roster.of(fleet(arm, again, drone))[1]).toBe(again);
    expect(roster.of(fleet())).toEqual([]);
  });
});
