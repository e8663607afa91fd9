/** What the feed `robot` tells of one robot, and how its data are put in order. */
import type { Json, Shown } from '../../lib/protocol';
import { formatValue, isNever, numberOf, qualityOf } from '../../lib/value';
import type { Tone } from '../../parts/tones';
import type { Argument } from '../../parts/arguments';

/** Entry `robot`. */
export interface About {
  name: string;
  node: string;
  description: string;
  origin: string;
  capacities: string[];
}

/** Entry `data/NODEID`: what a Variable is. */
export interface DataNode {
  path: string[];
  folder: 'Data' | 'Sensors';
  type: string;
  writable: boolean;
  /** Whether the server keeps its past, and this user may read it. */
  history: boolean;
  description: string;
  unit: string;
  low?: number;
  high?: number;
  names?: Record<string, string>;
}

/** Entry `skill/NAME`. */
export interface Skill {
  name: string;
  node: string;
  description: string;
  timeout_s: number;
  arguments: Argument[];
}

/** Entry `now/NAME`: how a skill stands. */
export interface Standing {
  state: 'Ready' | 'Running' | 'Suspended' | 'Halted' | null;
  s: number;
  execution: string;
  progress: number | null;
  message: string;
  status: string | null;
}

export type ExecutionState =
  'refused' | 'timed_out' | 'running' | 'done' | 'failed' | 'unknown' | 'asking' | 'suspended';

/** Entry `execution/ID`. */
export interface Execution {
  execution: string;
  /** Rises with the time at which they were begun. */
  place: number;
  skill: string;
  /** An ExecutionState, or a number that this page does not know. */
  state: string;
  progress: number | null;
  /** A JSON object with the results by name, as the robot wrote it. */
  result: string;
  message: string;
  status: string | null;
}

export const EXECUTION_TONES: Record<ExecutionState, Tone> = {
  refused: 'warn',
  timed_out: 'warn',
  running: 'active',
  done: 'normal',
  failed: 'alarm',
  unknown: 'unsure',
  asking: 'unsure',
  suspended: 'warn',
};

export function isKnown(state: string): state is ExecutionState {
  return Object.hasOwn(EXECUTION_TONES, state);
}

/** Whether an execution in this state has no end yet: what is told of it may be over. */
export function goesOn(state: string): boolean {
  return !['refused', 'timed_out', 'done', 'failed'].includes(state);
}

/** The last executions, the newest first. */
export function executionsOf(entries: ReadonlyMap<string, unknown>): Execution[] {
  const found = [...entries].filter(([key]) => key.startsWith('execution/')).map(([, entry]) => entry as Execution);
  return found.sort((a, b) => b.place - a.place);
}

/** Results by their names; what is no JSON object is shown as it was written. */
export function resultsOf(text: string): [string, Json][] {
  if (!text) return [];
  try {
    const results = JSON.parse(text) as Json;
    if (typeof results === 'object' && results !== null && !Array.isArray(results)) return Object.entries(results);
  } catch {
    // Whoever wrote it.
  }
  return [['', text]];
}

/** A line of the table of data. */
export interface DataRow {
  node: string;
  /** The last part of its path. */
  name: string;
  about: DataNode;
  /** Its value with its unit; undefined: none has come. */
  value: Shown | undefined;
}

export interface DataGroup {
  /** Folders above, as `pose` or `Sensors / gripper`; empty: directly in Data. */
  title: string;
  rows: DataRow[];
}

const rowsKnown = new WeakMap<DataNode | Shown, DataRow>();

/** The same row while its Variable and its value are, so that what has not changed is not looked at again. */
function rowOf(node: string, about: DataNode, told: Shown | undefined): DataRow {
  const known = rowsKnown.get(told ?? about);
  if (known?.node === node && known.about === about) return known;
  const value = told && about.unit ? { ...told, u: about.unit } : told;
  const row = { node, name: about.path.at(-1) ?? node, about, value };
  rowsKnown.set(told ?? about, row);
  return row;
}

/** Data in the groups of the address space, in its order; `words` in their path, description or value narrow them. */
export function groupsOf(entries: ReadonlyMap<string, unknown>, words: string): DataGroup[] {
  const wanted = words.toLowerCase().split(/\s+/).filter(Boolean);
  const groups = new Map<string, DataGroup>();
  for (const [key, entry] of entries) {
    if (!key.startsWith('data/')) continue;
    const node = key.slice('data/'.length);
    const about = entry as DataNode;
    if (wanted.length) {
      const text = [...about.path, about.folder, about.description].join('\n').toLowerCase();
      if (!wanted.every((word) => text.includes(word))) continue;
    }
    const above = about.path.slice(0, -1);
    const title = (about.folder === 'Data' ? above : [about.folder, ...above]).join(' / ');
    let group = groups.get(title);
    if (!group) groups.set(title, (group = { title, rows: [] }));
    group.rows.push(rowOf(node, about, entries.get(`value/${node}`) as Shown | undefined));
  }
  // What stands directly in Data has no folder, and so comes first; sensors come last.
  const rank = (group: DataGroup) => (group.title === '' ? 0 : group.rows[0]?.about.folder === 'Sensors' ? 2 : 1);
  return [...groups.values()].sort((a, b) => rank(a) - rank(b));
}

const NUMBERS = new Set(
  'SByte Byte Int16 UInt16 Int32 UInt32 Int64 UInt64 Float Double Number Integer UInteger Duration'.split(' '),
);

/** Whether its course can be drawn: a number that is none of an enumeration. */
export function isDrawn(about: DataNode): boolean {
  return NUMBERS.has(about.type) && !(about.names && Object.keys(about.names).length);
}

/** The number that is drawn of a value; null, a gap: it is not Good, or there is none. */
export function drawn(value: Shown | undefined): number | null {
  if (!value || isNever(value) || qualityOf(value.s) !== 'good') return null;
  const number = numberOf(value.v);
  return number !== null && Number.isFinite(number) ? number : null;
}

/** Whether it is a ByteString, which may be a picture. */
export function isBytes(value: Json): boolean {
  return typeof value === 'object' && value !== null && !Array.isArray(value) && typeof value.bytes === 'number';
}

/** NodeIds of what says how the bytes of a picture are to be read. */
export interface RawFields {
  encoding: string;
  width: string;
  height: string;
  step: string;
  is_bigendian?: string;
}

/** The fields beside a ByteString by which its bytes are the points of a `sensor_msgs/Image`; null: they are none. */
export function rawFieldsOf(entries: ReadonlyMap<string, unknown>, about: DataNode): RawFields | null {
  const above = about.path.slice(0, -1);
  const beside: Record<string, string> = {};
  for (const [key, entry] of entries) {
    if (!key.startsWith('data/')) continue;
    const { path, folder } = entry as DataNode;
    if (folder !== about.folder || path.length !== about.path.length || !above.every((part, at) => part === path[at]))
      continue;
    beside[path.at(-1) ?? ''] = key.slice('data/'.length);
  }
  const { encoding, width, height, step, is_bigendian } = beside;
  if (!encoding || !width || !height || !step) return null;
  return { encoding, width, height, step, ...(is_bigendian ? { is_bigendian } : {}) };
}

/** What a picture is called: one of a message is its `data`, so it has the name of the message. */
export function pictureName(about: DataNode, name: string): string {
  return (name === 'data' && about.path.at(-2)) || name;
}

/** Whether a value has parts that want lines of their own. */
export function hasParts(value: Json): boolean {
  return typeof value === 'object' && value !== null && leavesOf(value, 2).length > 1;
}

export interface Leaf {
  path: string;
  text: string;
}

/** The parts of an array or a structure, each with its path, as `corners[2].x`; at most `most`. */
export function leavesOf(value: Json, most: number): Leaf[] {
  const found: Leaf[] = [];
  const isOne = (one: Json) =>
    typeof one !== 'object' ||
    one === null ||
    (!Array.isArray(one) &&
      (typeof one.int === 'string' ||
        typeof one.float === 'string' ||
        typeof one.bytes === 'number' ||
        (typeof one.text === 'number' && typeof one.first === 'string')));
  const visit = (one: Json, path: string): void => {
    if (found.length >= most) return;
    if (isOne(one)) found.push({ path, text: formatValue(one) });
    else if (Array.isArray(one)) one.forEach((part, at) => visit(part, `${path}[${at}]`));
    else
      for (const name of Object.keys(one as object))
        visit((one as Record<string, Json>)[name] ?? null, path ? `${path}.${name}` : name);
  };
  visit(value, '');
  return found;
}

/** What a form gave, as the text that `node.write` takes. */
export function writtenText(value: Json): string {
  return typeof value === 'string' ? value : JSON.stringify(value);
}
