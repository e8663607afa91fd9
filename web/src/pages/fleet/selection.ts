/** Which robots are shown, in which order and groups: what stands in the page's address. */
import { ranksOf } from '../../parts/sorting';
import { type Robot, robotQuality, type Standing, STANDINGS, standingOf } from './robots';

export type SortName = 'name' | 'state' | 'updated' | 'task' | 'bridge';
export type GroupName = '' | 'state' | 'bridge' | 'capacity';
export const SORTS: readonly SortName[] = ['name', 'state', 'updated', 'task', 'bridge'];
export const GROUPS: readonly GroupName[] = ['', 'state', 'bridge', 'capacity'];

export interface Wish {
  /** Words, each of which stands somewhere in what is said of a robot. */
  text: string;
  state: Standing | 'held' | '';
  bridge: string;
  quality: 'good' | 'not-good' | '';
  sort: SortName;
  down: boolean;
  group: GroupName;
}

/** A robot within its group; one with several capacities stands in several. */
export interface Row {
  key: string;
  group: string;
  robot: Robot;
}

export function wishOf(query: (name: string) => string): Wish {
  const one = <T extends string>(all: readonly T[], value: string, other: T) =>
    (all as readonly string[]).includes(value) ? (value as T) : other;
  return {
    text: query('q'),
    state: one<Wish['state']>(['', 'held', ...STANDINGS], query('state'), ''),
    bridge: query('bridge'),
    quality: one<Wish['quality']>(['', 'good', 'not-good'], query('quality'), ''),
    sort: one(SORTS, query('sort'), 'name'),
    down: query('down') !== '',
    group: one(GROUPS, query('group'), ''),
  };
}

function textOf(robot: Robot): string {
  return [
    robot.name,
    robot.task,
    robot.run,
    robot.fault,
    robot.bridge,
    robot.held?.by,
    robot.held?.reason,
    ...(robot.capacities ?? []),
  ]
    .join('\n')
    .toLowerCase();
}

const TOLD: Record<SortName, (robot: Robot) => string | number | null> = {
  name: (robot) => robot.name,
  state: (robot) => STANDINGS.indexOf(standingOf(robot)),
  updated: (robot) => (robot.updated ? Date.parse(robot.updated) : null),
  task: (robot) => robot.task || null,
  bridge: (robot) => robot.bridge || null,
};

function groupsOf(robot: Robot, group: GroupName): string[] {
  if (group === 'state') return [standingOf(robot)];
  if (group === 'bridge') return [robot.bridge ?? ''];
  if (group === 'capacity') return robot.capacities?.length ? robot.capacities : [''];
  return [''];
}

/** The robots that are wished for, sorted within their groups. */
export function selected(robots: Iterable<Robot>, wish: Wish): Row[] {
  const words = wish.text.toLowerCase().split(/\s+/).filter(Boolean);
  const told = TOLD[wish.sort];
  const found: { row: Row; told: string | number | null }[] = [];
  for (const robot of robots) {
    if (wish.state === 'held' ? !robot.held : wish.state && standingOf(robot) !== wish.state) continue;
    if (wish.bridge && robot.bridge !== wish.bridge) continue;
    if (wish.quality && (robotQuality(robot) === 'good') !== (wish.quality === 'good')) continue;
    if (words.length) {
      const text = textOf(robot);
      if (!words.every((word) => text.includes(word))) continue;
    }
    for (const group of groupsOf(robot, wish.group)) {
      found.push({ row: { key: `${group}/${robot.name}`, group, robot }, told: told(robot) });
    }
  }
  const groups =
    wish.group === 'state'
      ? new Map<string, number>(STANDINGS.map((name, at) => [name, at]))
      : ranksOf(found.map((one) => one.row.group));
  const texts = ranksOf(
    wish.sort === 'name' ? [] : found.flatMap((one) => (typeof one.told === 'string' ? [one.told] : [])),
  );
  const names = nameRanks(found);
  const keyed = found.map(({ row, told }) => {
    const name = names.get(row.robot.name) ?? 0;
    const by = wish.sort === 'name' ? name : typeof told === 'string' ? (texts.get(told) ?? 0) : told;
    return { row, group: groups.get(row.group) ?? 0, by, name };
  });
  keyed.sort((a, b) => {
    if (a.group !== b.group) return a.group - b.group;
    if (a.by === null || b.by === null) {
      const last = Number(a.by === null) - Number(b.by === null);
      if (last) return last;
    } else if (a.by !== b.by) return wish.down ? b.by - a.by : a.by - b.by;
    return a.name - b.name;
  });
  return keyed.map((one) => one.row);
}

let ranked: ReadonlyMap<string, number> = new Map();

/** Names seldom change, so their order is kept; it has no more of them than were there at the last new one. */
function nameRanks(found: readonly { row: Row }[]): ReadonlyMap<string, number> {
  if (!found.every((one) => ranked.has(one.row.robot.name))) ranked = ranksOf(found.map((one) => one.row.robot.name));
  return ranked;
}

export interface Counts {
  all: number;
  held: number;
  states: Record<Standing, number>;
}

export function countsOf(robots: Iterable<Robot>): Counts {
  const counts: Counts = { all: 0, held: 0, states: { faulted: 0, offline: 0, unknown: 0, busy: 0, idle: 0 } };
  for (const robot of robots) {
    counts.all += 1;
    if (robot.held) counts.held += 1;
    counts.states[standingOf(robot)] += 1;
  }
  return counts;
}
