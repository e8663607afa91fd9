/** What a run has done and is at: its steps in their order, and who was at what when. */
import type { Fact, Outline, Step, TaskRow } from './types';

/** A line of the list of steps. */
export interface StepLine {
  key: string;
  depth: number;
  /** A step that is no task, or the branch of one; null where the scenario's text is another now. */
  step: Step | null;
  branch?: 'then' | 'else';
  /** Those of a task, one for each repetition that it has come to. */
  tasks: TaskRow[];
}

/** Things by what they have in common, in the order in which each of these is first met. */
export function groupedBy<T>(all: readonly T[], by: (one: T) => string): Map<string, T[]> {
  const groups = new Map<string, T[]>();
  for (const one of all) {
    const group = groups.get(by(one));
    if (group) group.push(one);
    else groups.set(by(one), [one]);
  }
  return groups;
}

/** A step's key without the numbers of repetitions. */
export const placeOf = (step: string) => step.split('@', 1)[0] ?? step;

/** The numbers of repetitions that a step's key has, as `1·3`, counted from 1; empty: it is in none. */
export function repetitionOf(step: string): string {
  return step
    .split('@')
    .slice(1)
    .map((number) => String(Number(number) + 1))
    .join('·');
}

function isDescribed(outline: Outline, tasks: readonly TaskRow[]): boolean {
  const names = new Map<string, string>();
  const note = (steps: readonly Step[]): void => {
    for (const step of steps) {
      if (step.kind === 'task') names.set(step.step, step.name);
      else for (const below of belowOf(step)) note(below.steps);
    }
  };
  note(outline.steps);
  return tasks.every((one) => names.get(placeOf(one.step)) === one.task);
}

function belowOf(step: Step): { branch?: 'then' | 'else'; steps: Step[] }[] {
  if (step.kind === 'if') {
    return [
      { branch: 'then', steps: step.then },
      { branch: 'else', steps: step.else },
    ];
  }
  return 'steps' in step ? [{ steps: step.steps }] : [];
}

/** Steps as lines. Where the text has changed since the run began, so that its tasks are not there, only these. */
export function linesOf(outline: Outline | null, tasks: readonly TaskRow[]): StepLine[] {
  if (!outline || !isDescribed(outline, tasks)) {
    return tasks.map((one) => ({ key: one.step, depth: 0, step: null, tasks: [one] }));
  }
  const byPlace = groupedBy(tasks, (one) => placeOf(one.step));
  const lines: StepLine[] = [];
  const add = (steps: readonly Step[], depth: number, inParallel = false): void => {
    for (const one of steps) {
      // A branch of one step is that step.
      const only = inParallel && one.kind === 'sequence' && one.steps.length === 1 ? one.steps[0] : undefined;
      const step = only ?? one;
      lines.push({ key: step.step, depth, step, tasks: byPlace.get(step.step) ?? [] });
      for (const { branch, steps: below } of belowOf(step)) {
        if (branch && below.length) {
          lines.push({ key: `${step.step} ${branch}`, depth: depth + 1, step, branch, tasks: [] });
        }
        add(below, branch ? depth + 2 : depth + 1, step.kind === 'parallel');
      }
    }
  };
  add(outline.steps, 0);
  return lines;
}

/** One attempt of a robot at a task. Times are null where nobody looked when it began or ended. */
export interface Attempt {
  key: string;
  step: string;
  task: string;
  robot: string;
  attempt: number;
  from: number | null;
  to: number | null;
  /** As `done`; empty: it is at it. */
  outcome: string;
}

/** Facts in the order of their times, each once, however often the feed has begun anew. */
export function mergedFacts(known: readonly Fact[], told: Iterable<Fact>): Fact[] {
  const all = new Map<string, Fact>();
  for (const fact of [...known, ...told]) all.set(JSON.stringify([fact.at, fact.fact, fact.task, fact.detail]), fact);
  return [...all.values()].sort((a, b) => a.at.localeCompare(b.at));
}

const AT_IT = new Set(['assigned', 'accepted', 'halting', 'asked', 'lost']);

/** Who was at what when, by what the server keeps of each task's last attempt, and by facts of those before it. */
export function attemptsOf(facts: readonly Fact[], tasks: readonly TaskRow[]): Attempt[] {
  const all = new Map<string, Attempt>();
  for (const fact of facts) {
    const step = fact.detail?.step;
    const attempt = fact.detail?.attempt;
    if (typeof step !== 'string' || typeof attempt !== 'number') continue;
    const key = `${step}#${attempt}`;
    const at = Date.parse(fact.at);
    if (fact.fact === 'TaskAssigned') {
      const robot = fact.robot ?? '';
      all.set(key, { key, step, task: fact.task ?? '', robot, attempt, from: at, to: null, outcome: '' });
    } else if (fact.fact === 'TaskOver') {
      const known = all.get(key);
      const robot = known?.robot || fact.robot || '';
      const from = known?.from ?? null;
      all.set(key, {
        ...{ key, step, task: fact.task ?? '', robot, attempt, from, to: at },
        outcome: fact.outcome || String(fact.detail?.outcome ?? ''),
      });
    }
  }
  for (const one of tasks) {
    const key = `${one.step}#${one.attempt}`;
    const known = all.get(key);
    const timeOf = (at: string | null | undefined) => (at ? Date.parse(at) : null);
    const [from, to] = [known?.from ?? timeOf(one.begun), known?.to ?? timeOf(one.ended)];
    if (!one.robot || (!known && from === null && !AT_IT.has(one.state))) continue;
    const { step, task, robot, attempt } = one;
    const ended = to === null ? '' : one.state === 'done' ? 'done' : 'failed';
    all.set(key, { ...(known ?? { key, step, task, robot, attempt }), from, to, outcome: known?.outcome || ended });
  }
  return inOrder([...all.values()]);
}

/** As they began; what began before anybody looked began first. */
const inOrder = (all: Attempt[]): Attempt[] => all.sort((a, b) => (a.from ?? -Infinity) - (b.from ?? -Infinity) || 0);

/** Attempts as they are told of now, and those that were told of before: of a task the server keeps only the last one. */
export function withEarlier(now: readonly Attempt[], before: readonly Attempt[]): Attempt[] {
  const known = new Set(now.map((one) => one.key));
  // Of one that was not over then nobody knows when it ended.
  return inOrder([...now, ...before.filter((one) => !known.has(one.key) && one.to !== null)]);
}

const MOST_RUNS_KEPT = 50;
const kept = new Map<string, readonly Attempt[]>();

/** What this page was told of a run's attempts, however often its view is left and opened again. */
export const attemptsKept = (fleet: string, run: string): readonly Attempt[] => kept.get(`${fleet}/${run}`) ?? [];

/** Keep what was told of a run's attempts, for so many runs: those that were told of last. */
export function keepAttempts(fleet: string, run: string, attempts: readonly Attempt[]): void {
  kept.delete(`${fleet}/${run}`);
  kept.set(`${fleet}/${run}`, attempts);
  for (const key of [...kept.keys()].slice(0, -MOST_RUNS_KEPT)) kept.delete(key);
}

/** Where a bar stands between the times of a chart, in parts of its width. */
export function barOf(attempt: Attempt, first: number, last: number): { left: number; width: number } {
  const span = Math.max(1, last - first);
  const part = (at: number) => Math.min(1, Math.max(0, (at - first) / span));
  const left = part(attempt.from ?? first);
  return { left, width: Math.max(0, part(attempt.to ?? last) - left) };
}

export type LabelPlace = 'in' | 'after' | 'before' | 'nowhere';

/** Where the texts of a line's bars have room, each of `room` as a part of the chart's width; the bars in their order. */
export function labelPlaces(bars: readonly { left: number; width: number }[], room: number): LabelPlace[] {
  let taken = 0;
  return bars.map(({ left, width }, at) => {
    const end = left + width;
    const isAfter = (bars[at + 1]?.left ?? 1) - end >= room;
    const place = width >= room ? 'in' : isAfter ? 'after' : left - taken >= room ? 'before' : 'nowhere';
    taken = Math.max(taken, place === 'after' ? end + room : end);
    return place;
  });
}

const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200, 86400];

/** Times in seconds from the beginning that a chart of so many seconds has lines at: few, and round ones. */
export function ticksOf(span_s: number, most: number): number[] {
  const step = STEPS_S.find((one) => span_s / one <= most) ?? Math.ceil(span_s / most / 86400) * 86400;
  const count = Math.floor(span_s / step + 1e-9);
  return Array.from({ length: count + 1 }, (_, at) => Number((at * step).toFixed(3)));
}

/** A time since the beginning. */
export function secondsText(s: number): string {
  if (s >= 6000) return `${Number((s / 3600).toFixed(1))} h`;
  return s >= 600 ? `${Number((s / 60).toFixed(1))} min` : `${Number(s.toFixed(2))} s`;
}
