/** Which robots are shown, in which order and groups: what stands in the page's address. */
import { compared } from '../../parts/sorting';
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
  const keyed: { row: Row; sort: string | number | null; at: number }[] = [];
  for (const robot of robots) {
    if (wish.state === 'held' ? !robot.held : wish.state && standingOf(robot) !== wish.state) continue;
    if (wish.bridge && robot.bridge !== wish.bridge) continue;
    if (wish.quality && (robotQuality(robot) === 'good') !== (wish.quality === 'good')) continue;
    if (words.length) {
      const text = textOf(robot);
      if (!words.every((word) => text.includes(word))) continue;
    }
    for (const group of groupsOf(robot, wish.group)) {
      const at = wish.group === 'state' ? STANDINGS.indexOf(group as Standing) : 0;
      keyed.push({ row: { key: `${group}/${robot.name}`, group, robot }, sort: told(robot), at });
    }
  }
  keyed.sort((a, b) => {
    const groups = a.at - b.at || compared(a.row.group, b.row.group);
    if (groups) return groups;
    if (a.sort === null || b.sort === null) {
      const last = Number(a.sort === null) - Number(b.sort === null);
      if (last) return last;
    } else {
      const by = wish.down ? compared(b.sort, a.sort) : compared(a.sort, b.sort);
      if (by) return by;
    }
    return compared(a.row.robot.name, b.row.robot.name);
  });
  return keyed.map((one) => one.row);
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
