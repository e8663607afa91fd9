/** Scenarios and runs as the console tells them. */
import type { Json } from '../../lib/protocol';
import type { IconName } from '../../parts/icons';
import type { Tone } from '../../parts/tones';

export interface Listed {
  name: string;
  description: string;
  /** How many things are wrong with it. */
  problems: number;
}

export type RunState = 'running' | 'paused' | 'ending' | 'done' | 'failed' | 'aborted';
export type TaskState =
  'wanted' | 'assigned' | 'accepted' | 'halting' | 'replacing' | 'asked' | 'lost' | 'done' | 'failed';
/** How a task is shown: also as one that nobody will be asked for any more. */
export type ShownState = TaskState | 'skipped';

/** A run of the list. */
export interface RunRow {
  id: string;
  state: RunState;
  scenario: string;
  started: string | null;
  ended: string | null;
  by: string;
  reason: string;
  tasks: Partial<Record<TaskState, number>>;
  at: { task: string; robot: string; state: TaskState }[];
}

/** A bridge that carries a run, as the server sees it. */
export interface Carrier {
  bridge: string;
  /** Silent: for so long that a person can leave it out. Empty: nothing was heard yet, or the run is over. */
  state: 'answers' | 'away' | 'silent' | '';
  /** Whether it had a token when it was heard last. */
  token: boolean;
  message: string;
}

export type RunHead = Omit<RunRow, 'tasks' | 'at'> & {
  parameters: Record<string, Json>;
  /** None: the server orchestrates it. */
  bridges: Carrier[];
};

/** A task of a run, in one repetition: `step` has its number at the end, as `2.repeat.0@1`. */
export interface TaskRow {
  step: string;
  task: string;
  robot: string;
  skill: string;
  state: TaskState;
  attempt: number;
  result: Record<string, Json>;
  message: string;
  /** When this attempt began and ended; null where it has not, or the server does not tell. */
  begun?: string | null;
  ended?: string | null;
}

/** Something that happened in a run while somebody looked. */
export interface Fact {
  at: string;
  fact: string;
  task?: string;
  robot?: string;
  skill?: string;
  outcome?: string;
  detail?: Record<string, Json>;
  text?: string;
}

export interface Parameter {
  name: string;
  default: Json;
  unit: string;
  low: number | null;
  high: number | null;
  help: string;
}

interface At {
  step: string;
  line: number;
}

/** A step of a scenario's text. */
export type Step = At &
  (
    | { kind: 'task'; name: string; skill: string; robot: string | null; capacities: string[]; after: string[] }
    | { kind: 'sequence' | 'parallel'; steps: Step[] }
    | { kind: 'repeat'; steps: Step[]; times: number | null; while: string | null }
    | { kind: 'if'; when: string; then: Step[]; else: Step[] }
    | { kind: 'wait'; for_s: number | null; until: string | null; event: string | null; timeout_s: number | null }
    | { kind: 'end'; outcome: string; reason: string }
  );

export interface Outline {
  name: string;
  description: string;
  parameters: Parameter[];
  steps: Step[];
  problems: { line: number; message: string }[];
}

export const RUN_TONES: Record<RunState, Tone> = {
  running: 'active',
  paused: 'warn',
  ending: 'active',
  done: 'normal',
  failed: 'alarm',
  aborted: 'warn',
};
export const RUN_ICONS: Partial<Record<RunState, IconName>> = { running: 'play', paused: 'hold', done: 'check' };

export const TASK_TONES: Record<ShownState, Tone> = {
  skipped: 'off',
  wanted: 'off',
  assigned: 'active',
  accepted: 'active',
  halting: 'warn',
  replacing: 'warn',
  asked: 'unsure',
  lost: 'unsure',
  done: 'normal',
  failed: 'alarm',
};
export const TASK_ICONS: Partial<Record<ShownState, IconName>> = {
  wanted: 'idle',
  assigned: 'play',
  accepted: 'busy',
  done: 'check',
};

/** Whether nothing more comes of a run. */
export const isOver = (state: RunState) => state === 'done' || state === 'failed' || state === 'aborted';

/** How a task is shown, given once it was asked for, and whether its run is over. */
export function shownState(task: TaskRow | null | undefined, over: boolean): ShownState {
  const state = task?.state ?? 'wanted';
  return over && state === 'wanted' ? 'skipped' : state;
}
