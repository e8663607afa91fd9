/**
 * What a dry run says, as lanes over columns. Robots do at once what they are asked, so most of it happens at one time:
 * a column is what is under way together, and its head tells the time, which waits alone move on.
 */
import type { Outline, Step } from './types';
import { placeOf, repetitionOf } from './runs';
import { titleOf } from './steps';

export interface Moment {
  /** Seconds since the start of the run. */
  at_s: number;
  step: string;
  text: string;
}

export interface Rehearsed {
  /** `done`, `failed` or `aborted`; empty: it would not end. */
  outcome: string;
  reason: string;
  timeline: Moment[];
}

export type MomentKind = 'begins' | 'over' | 'decided' | 'failed' | 'ends';

/** A moment with what its text means. */
export interface Told extends Moment {
  kind: MomentKind;
  /** What the step is called; empty: it is the run. */
  title: string;
  robot: string;
  skill: string;
  /** Where the step stands in the text; 0: it is the run. */
  line: number;
}

export interface Bar {
  key: string;
  /** First and last column. */
  from: number;
  to: number;
  text: string;
  robot: string;
  /** As `done`; empty: it is not over. */
  outcome: string;
  kind: 'task' | 'decided' | 'failed';
}

export interface Lane {
  key: string;
  title: string;
  bars: Bar[];
}

export interface Rehearsal {
  told: Told[];
  /** The time of each column. */
  columns: number[];
  bySteps: Lane[];
  byRobots: Lane[];
}

const OUTCOMES = new Set([
  ...['done', 'failed', 'stopped', 'refused', 'busy', 'unreached', 'timed_out', 'unknown', 'fault', 'halted'],
]);

function stepsOf(steps: readonly Step[]): Step[] {
  return steps.flatMap((step) => {
    if (step.kind === 'if') return [step, ...stepsOf(step.then), ...stepsOf(step.else)];
    return 'steps' in step ? [step, ...stepsOf(step.steps)] : [step];
  });
}

function toldOf(moment: Moment, step: Step | undefined): Told {
  const told = { ...moment, robot: '', skill: '', line: step?.line ?? 0 };
  if (!moment.step) return { ...told, kind: 'ends', title: '' };
  const title = step ? titleOf(step) : moment.step;
  if (step?.kind !== 'task') {
    const decided = /^(?:the condition |repetition |event )/.test(moment.text);
    return { ...told, title, kind: decided ? 'decided' : 'failed' };
  }
  if (OUTCOMES.has(moment.text)) return { ...told, title, kind: 'over' };
  const begins = `${step.name}: `;
  const asked = moment.text.indexOf(` ${step.skill}(`, begins.length);
  if (!moment.text.startsWith(begins) || asked < 0) return { ...told, title, kind: 'failed' };
  return {
    ...told,
    title,
    kind: 'begins',
    robot: moment.text.slice(begins.length, asked),
    skill: moment.text.slice(asked + 1),
  };
}

/** Lanes in the order of the scenario; of robots in the order in which they begin something. */
export function rehearsalOf(timeline: readonly Moment[], outline: Outline | null): Rehearsal {
  const steps = new Map(stepsOf(outline?.steps ?? []).map((step) => [step.step, step]));
  const told = timeline.map((one) => toldOf(one, steps.get(placeOf(one.step))));
  const columns: number[] = [];
  const bySteps = new Map<string, Lane>([...steps.keys()].map((key) => [key, { key, title: '', bars: [] }]));
  const byRobots = new Map<string, Lane>();
  const open = new Map<string, Bar>();
  const laneOf = (lanes: Map<string, Lane>, key: string, title: string): Lane => {
    const lane = lanes.get(key) ?? { key, title, bars: [] };
    lane.title = title;
    lanes.set(key, lane);
    return lane;
  };
  let before: Told | null = null;
  for (const one of told) {
    if (one.kind === 'ends') continue;
    const lane = laneOf(bySteps, placeOf(one.step), one.title);
    const own = one.robot ? laneOf(byRobots, one.robot, one.robot) : null;
    const last = Math.max(0, columns.length - 1);
    const busy = one.kind !== 'over' && [lane, own].some((each) => each?.bars.some((bar) => bar.to === last));
    const goesOn = before?.kind === 'over' && one.kind !== 'over';
    if (before?.at_s !== one.at_s || busy || goesOn) columns.push(one.at_s);
    before = one;
    const now = columns.length - 1;
    const bar: Bar = {
      ...{ key: `${lane.bars.length}`, from: now, to: now, text: one.text, robot: one.robot, outcome: '' },
      kind: one.kind === 'begins' ? 'task' : one.kind === 'failed' ? 'failed' : 'decided',
    };
    if (one.kind === 'over') {
      const begun = open.get(one.step);
      if (begun) Object.assign(begun, { to: now, outcome: one.text });
      open.delete(one.step);
    } else {
      const repetition = repetitionOf(one.step);
      bar.text = one.kind === 'begins' ? [one.title, repetition, one.skill].filter(Boolean).join(' · ') : one.text;
      lane.bars.push(bar);
      own?.bars.push(bar);
      if (one.kind === 'begins') open.set(one.step, bar);
    }
  }
  // What is not over at the end goes on to it.
  for (const bar of open.values()) bar.to = Math.max(bar.to, columns.length - 1);
  const used = (lanes: Map<string, Lane>) => [...lanes.values()].filter((lane) => lane.bars.length);
  return { told, columns, bySteps: used(bySteps), byRobots: used(byRobots) };
}

const WORDS = new Set(['and', 'or', 'not', 'true', 'false', 'True', 'False']);

/** Names of which conditions of a scenario ask the value, but for its parameters. */
export function namesAsked(outline: Outline): string[] {
  const conditions = stepsOf(outline.steps).flatMap((step) => {
    if (step.kind === 'if') return [step.when];
    if (step.kind === 'repeat') return [step.while ?? ''];
    return step.kind === 'wait' ? [step.until ?? ''] : [];
  });
  const own = new Set(outline.parameters.map((one) => one.name));
  const names = conditions.flatMap((text) => [
    ...text.replace(/'[^']*'|"[^"]*"/g, '').matchAll(/[A-Za-z_]\w*(?:\.\w+)*(?:\[\d+\])?/g),
  ]);
  return [...new Set(names.map((found) => found[0]))].filter((name) => !own.has(name) && !WORDS.has(name));
}
