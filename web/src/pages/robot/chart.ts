/** What a chart draws of a robot's numbers: common times, gaps, panels by unit; and the same as a table. Times in ms. */
import { parseWatched } from '../space/watched';
import type { History } from './history';

export const SPANS_MS = [60_000, 600_000] as const;
/** More lines than this nobody tells apart. */
export const MOST_LINES = 6;
/** Strokes of lines beside their colours, in pixels. */
export const DASHES: readonly (readonly number[])[] = [[], [8, 4], [2, 3], [10, 3, 2, 3], [5, 5], [1, 5]];
const TABLE_ROWS = 12;

export interface Line {
  node: string;
  name: string;
  unit: string;
  history: History;
}

export interface Panel {
  unit: string;
  /** Each with its place among all lines, which is its colour and stroke. */
  lines: { line: Line; place: number }[];
}

/** NodeIds of the lines that the address of the page names. */
export function parseLines(text: string): string[] {
  return parseWatched(text).slice(0, MOST_LINES);
}

/** One more line, or one less; with too many the first one goes. */
export function toggled(nodes: readonly string[], node: string): string[] {
  if (nodes.includes(node)) return nodes.filter((one) => one !== node);
  return [...nodes, node].slice(-MOST_LINES);
}

/** Numbers of one unit share an axis. */
export function panelsOf(lines: readonly Line[]): Panel[] {
  const panels = new Map<string, Panel>();
  lines.forEach((line, place) => {
    let panel = panels.get(line.unit);
    if (!panel) panels.set(line.unit, (panel = { unit: line.unit, lines: [] }));
    panel.lines.push({ line, place });
  });
  return [...panels.values()];
}

/** Times in seconds, then the numbers of each line at them; null: a gap. */
export type Aligned = [number[], ...(number | null)[][]];

/** Lines with common times between `from` and `to`. A number holds until the next one, or until its gap begins. */
export function aligned(histories: readonly History[], from: number, to: number): Aligned {
  const times = new Set([from, to]);
  for (const { times: changes, values } of histories) {
    changes.forEach((at, index) => {
      if (at <= from || at >= to) return;
      times.add(at);
      // Held until the moment before: a gap begins where it ends.
      if (values[index] === null) times.add(at - 1);
    });
  }
  const sorted = [...times].sort((a, b) => a - b);
  return [sorted.map((at) => at / 1000), ...histories.map((history) => heldAt(history, sorted))];
}

/** What a number was at times that rise. */
export function heldAt(history: History, times: readonly number[]): (number | null)[] {
  let index = -1;
  return times.map((time) => {
    while (index + 1 < history.times.length && (history.times[index + 1] ?? 0) <= time) index += 1;
    return index < 0 ? null : (history.values[index] ?? null);
  });
}

export interface Course {
  now: number | null;
  least: number | null;
  greatest: number | null;
}

/** A line in three numbers. */
export function courseOf(history: History, from: number, to: number): Course {
  const [, held = []] = aligned([history], from, to);
  let least: number | null = null;
  let greatest: number | null = null;
  for (const one of held) {
    if (one === null) continue;
    least = least === null || one < least ? one : least;
    greatest = greatest === null || one > greatest ? one : greatest;
  }
  return { now: held.at(-1) ?? null, least, greatest };
}

/** Times of a table's rows, the newest first: they are round, so that a row stays what it is while time goes on. */
export function tableTimes(to: number, span: number): number[] {
  const step = span / TABLE_ROWS;
  const newest = Math.floor(to / step) * step;
  return Array.from({ length: TABLE_ROWS }, (_, row) => newest - row * step);
}
