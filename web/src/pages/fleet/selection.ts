/** Which robots are shown, in which order and groups: what stands in the page's address. */
import { ranksOf } from '../../parts/sorting';
import { hasFault, type Robot, robotQuality, type Standing, STANDINGS, standingOf } from './robots';

export type SortName = 'name' | 'state' | 'updated' | 'task' | 'bridge';
export type GroupName = '' | 'state' | 'bridge' | 'capacity';
export const SORTS: readonly SortName[] = ['name', 'state', 'updated', 'task', 'bridge'];
export const GROUPS: readonly GroupName[] = ['', 'state', 'bridge', 'capacity'];

export interface Wish {
  /** Words, each of which stands somewhere in what is said of a robot. */
  text: string;
  state: Standing | 'held' | 'fault' | '';
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
    state: one<Wish['state']>(['', 'held', 'fault', ...STANDINGS], query('state'), ''),
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

function isLike(robot: Robot, state: Exclude<Wish['state'], ''>): boolean {
  if (state === 'held') return Boolean(robot.held);
  return state === 'fault' ? hasFault(robot) : standingOf(robot) === state;
}

/** A source that lives tells its last value again each 5 s, where `repeat_interval_s` says nothing else. */
const FRESH_S = 10;

/** By name when data of robots came that are not fresh; null: nobody knows. */
export type Ages = ReadonlyMap<string, number | null>;

/**
 * What an order by age goes by; the map of before where it is the same. All that are fresh are equal: otherwise robots
 * that tell something each second would change their places with each message, and none could be pressed.
 */
export function agesOf(robots: Iterable<Robot>, nowMs: number, before: Ages): Ages {
  const ages = new Map<string, number | null>();
  let same = true;
  // Times are told in one form, in which the later one is the greater text: most need not be read. To the second, since
  // of a whole one no parts are told.
  const text = (at: number) => new Date(at).toISOString().slice(0, 19);
  const [fresh, tomorrow] = [text(nowMs - (FRESH_S - 1) * 1000), text(nowMs + 86_400_000)];
  for (const { name, updated } of robots) {
    if (updated && updated > fresh && updated < tomorrow) continue;
    const at = updated ? Date.parse(updated) : NaN;
    if (nowMs - at < FRESH_S * 1000) continue;
    const known = Number.isNaN(at) ? null : at;
    ages.set(name, known);
    same &&= before.get(name) === known;
  }
  return same && ages.size === before.size ? before : ages;
}

const TOLD: Record<Exclude<SortName, 'name' | 'updated'>, (robot: Robot) => string | number | null> = {
  state: (robot) => STANDINGS.indexOf(standingOf(robot)),
  task: (robot) => robot.task || null,
  bridge: (robot) => robot.bridge || null,
};

function groupsOf(robot: Robot, group: GroupName): string[] {
  if (group === 'state') return [standingOf(robot)];
  if (group === 'bridge') return [robot.bridge ?? ''];
  if (group === 'capacity') return robot.capacities?.length ? robot.capacities : [''];
  return [''];
}

/** Names seldom change, so their order is kept; it has no more of them than were there at the last new one. */
let ranked: ReadonlyMap<string, number> = new Map();

/**
 * The robots that are wished for, sorted within their groups. Asked for of all robots whenever one of them changes.
 *
 * @param ages for the order by them
 */
export function selected(robots: Iterable<Robot>, wish: Wish, ages: Ages = new Map()): Row[] {
  const words = wish.text.toLowerCase().split(/\s+/).filter(Boolean);
  const groups = new Map<string, Row[]>();
  let known = true;
  for (const robot of robots) {
    if (wish.state && !isLike(robot, wish.state)) continue;
    if (wish.bridge && robot.bridge !== wish.bridge) continue;
    if (wish.quality && (robotQuality(robot) === 'good') !== (wish.quality === 'good')) continue;
    if (words.length) {
      const text = textOf(robot);
      if (!words.every((word) => text.includes(word))) continue;
    }
    known &&= ranked.has(robot.name);
    for (const row of rowsOf(robot, wish.group)) {
      const rows = groups.get(row.group);
      if (rows) rows.push(row);
      else groups.set(row.group, [row]);
    }
  }
  if (!known) ranked = ranksOf([...groups.values()].flatMap((rows) => rows.map((row) => row.robot.name)));
  // Each group by itself: in most of them the rows stand as they are to stand.
  return groupsInOrder([...groups.keys()], wish.group).flatMap((group) => inOrder(groups.get(group) ?? [], wish, ages));
}

function groupsInOrder(names: string[], group: GroupName): string[] {
  if (names.length < 2) return names;
  const ranks = group === 'state' ? new Map<string, number>(STANDINGS.map((name, at) => [name, at])) : ranksOf(names);
  return names.sort((a, b) => (ranks.get(a) ?? 0) - (ranks.get(b) ?? 0));
}

/** Rows of one group by what is wished, and by name where that is equal. */
function inOrder(rows: Row[], wish: Wish, ages: Ages): Row[] {
  const name = rows.map(({ robot }) => ranked.get(robot.name) ?? 0);
  let by: readonly (number | null)[] = name;
  if (wish.sort === 'updated') {
    // Where all are fresh, all are equal.
    if (ages.size) by = rows.map(({ robot }) => ages.get(robot.name) ?? (ages.has(robot.name) ? null : Infinity));
  } else if (wish.sort !== 'name') {
    const told = TOLD[wish.sort];
    by = toldRanks(rows.map((row) => told(row.robot)));
  }
  const down = wish.down && (wish.sort !== 'updated' || by !== name);
  const compare = (a: number, b: number): number => {
    const [one, other] = [by[a] ?? null, by[b] ?? null];
    if (one !== other) {
      if (one === null) return 1;
      if (other === null) return -1;
      return down ? other - one : one - other;
    }
    return (name[a] ?? 0) - (name[b] ?? 0);
  };
  // The console tells robots in the order of their names, mostly: then there is nothing to do.
  if (!rows.some((_, at) => at > 0 && compare(at - 1, at) > 0)) return rows;
  return rows
    .map((_, at) => at)
    .sort(compare)
    .flatMap((at) => rows[at] ?? []);
}

const rowsKnown = new WeakMap<Robot, Partial<Record<GroupName, Row[]>>>();

/** The same rows for the same robot and groups, so that what has not changed is not looked at again. */
function rowsOf(robot: Robot, by: GroupName): readonly Row[] {
  let known = rowsKnown.get(robot);
  if (!known) rowsKnown.set(robot, (known = {}));
  return (known[by] ??= groupsOf(robot, by).map((group) => {
    return { key: by ? `${group}/${robot.name}` : robot.name, group, robot };
  }));
}

/** The rows of before, where they are the same. */
export function sameRows(before: readonly Row[], now: readonly Row[]): readonly Row[] {
  return before.length === now.length && now.every((row, at) => row === before[at]) ? before : now;
}

/** Rows as many beside each other as there is room for; a line that is the same as before is the same object. */
export type Line = { key: string; group: string; count: number } | { key: string; rows: Row[] };

export function linesOf(rows: readonly Row[], across: number, grouped: boolean, before: readonly Line[]): Line[] {
  const known = new Map(before.map((line) => [line.key, line]));
  const same = (line: Line): Line => {
    const old = known.get(line.key);
    if (!old || 'rows' in old !== 'rows' in line) return line;
    if ('rows' in old && 'rows' in line) {
      return old.rows.length === line.rows.length && old.rows.every((row, at) => row === line.rows[at]) ? old : line;
    }
    return 'count' in old && 'count' in line && old.count === line.count ? old : line;
  };
  const all: Line[] = [];
  for (let at = 0; at < rows.length;) {
    const group = rows[at]?.group ?? '';
    let end = at;
    while (end < rows.length && rows[end]?.group === group) end += 1;
    if (grouped) all.push(same({ key: `#${group}`, group, count: end - at }));
    for (; at < end; at += across) {
      const part = rows.slice(at, Math.min(at + across, end));
      all.push(same({ key: part[0]?.key ?? '', rows: part }));
    }
    at = end;
  }
  return all;
}

/** Texts by their order among each other. */
function toldRanks(told: readonly (string | number | null)[]): (number | null)[] {
  const ranks = ranksOf(told.filter((one) => typeof one === 'string'));
  return told.map((one) => (typeof one === 'string' ? (ranks.get(one) ?? 0) : one));
}

/** The bridges that robots have, by name; the array of before where they are the same. */
export function bridgesOf(robots: Iterable<Robot>, before: readonly string[]): readonly string[] {
  const names = new Set<string>();
  for (const { bridge } of robots) if (bridge) names.add(bridge);
  return names.size === before.length && before.every((name) => names.has(name)) ? before : [...names].sort();
}

export interface Counts {
  all: number;
  held: number;
  /** Also those that can do something else meanwhile, and are idle or busy. */
  fault: number;
  states: Record<Standing, number>;
}

export function countsOf(robots: Iterable<Robot>): Counts {
  const counts: Counts = {
    all: 0,
    held: 0,
    fault: 0,
    states: { faulted: 0, offline: 0, unknown: 0, busy: 0, idle: 0 },
  };
  for (const robot of robots) {
    counts.all += 1;
    if (robot.held) counts.held += 1;
    if (hasFault(robot)) counts.fault += 1;
    counts.states[standingOf(robot)] += 1;
  }
  return counts;
}
