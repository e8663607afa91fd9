/** The bridges of a carried run: how each is shown, and what a person can say of one that is off. */
import type { IconName } from '../../parts/icons';
import type { Tone } from '../../parts/tones';
import type { Carrier, Outline, Step, TaskRow } from './types';

/** How a bridge is shown: also as one that has the token. */
export type CarrierState = 'token' | 'waits' | 'away' | 'silent' | 'unknown' | 'over';

export function carrierState(one: Carrier, over: boolean): CarrierState {
  if (over) return 'over';
  if (one.state === 'away' || one.state === 'silent') return one.state;
  if (one.state !== 'answers') return 'unknown';
  return one.token ? 'token' : 'waits';
}

export const CARRIER_TONES: Record<CarrierState, Tone> = {
  token: 'active',
  waits: 'normal',
  away: 'warn',
  silent: 'alarm',
  unknown: 'unsure',
  over: 'off',
};
export const CARRIER_ICONS: Partial<Record<CarrierState, IconName>> = { token: 'play', waits: 'idle', over: 'check' };

/** A task that robots of a bridge may have done without the server's knowing it. */
export interface OpenTask {
  step: string;
  task: string;
  /** Empty: whoever has the capacity. */
  robot: string;
}

/**
 * Tasks that are not known to be over, of robots that a bridge may have told to do them. Those whose turn has not come as
 * far as is known are among them, but for those of repetitions, whose number nobody knows.
 */
export function openTasks(
  outline: Outline | null,
  tasks: readonly TaskRow[],
  isOfBridge: (robot: string) => boolean,
): OpenTask[] {
  const known = new Set(tasks.map((one) => one.step));
  const found = tasks
    .filter((one) => one.state !== 'done' && one.state !== 'failed')
    .map(({ step, task, robot }) => ({ step, task, robot }));
  const add = (steps: readonly Step[]): void => {
    for (const step of steps) {
      if (step.kind === 'task') {
        if (!known.has(step.step)) found.push({ step: step.step, task: step.name, robot: step.robot ?? '' });
      } else if (step.kind === 'if') add([...step.then, ...step.else]);
      else if (step.kind === 'sequence' || step.kind === 'parallel') add(step.steps);
    }
  };
  add(outline?.steps ?? []);
  return found.filter((one) => !one.robot || isOfBridge(one.robot));
}
