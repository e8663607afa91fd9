/** An entry of the feed `robots`, and how it is told. What is absent is not known. */
import type { Shown } from '../../lib/protocol';
import { type Quality, qualityOf } from '../../lib/value';
import type { IconName } from '../../parts/icons';
import type { Tone } from '../../parts/tones';

export type RobotState = 'offline' | 'idle' | 'busy' | 'faulted';

export interface Robot {
  name: string;
  state: Shown & { v: RobotState | null };
  /** The worst StatusCode of its values. */
  quality?: number;
  /** When data of it last reached the server. */
  updated?: string | null;
  task?: string;
  run?: string;
  held?: { by: string; since?: string | null; reason?: string } | null;
  /** How many there are, and the first of them in words. */
  faults?: number;
  fault?: string;
  bridge?: string;
  capacities?: string[];
  /** What `fleet.yaml` marks. */
  marked?: (Shown & { name: string; names?: Record<string, string> })[];
}

/** What it is, as far as that is known. */
export type Standing = RobotState | 'unknown';

/** By how much they want somebody's eyes. */
export const STANDINGS: readonly Standing[] = ['faulted', 'offline', 'unknown', 'busy', 'idle'];

export function standingOf(robot: Robot): Standing {
  return robot.state.v !== null && qualityOf(robot.state.s) === 'good' ? robot.state.v : 'unknown';
}

/** Whether something of it is out of order; it may do what does not need that, and be idle or busy. */
export const hasFault = (robot: Robot) => Boolean(robot.fault) || (robot.faults ?? 0) > 0;

export const TONES: Record<Standing, Tone> = {
  faulted: 'alarm',
  offline: 'off',
  unknown: 'unsure',
  busy: 'active',
  idle: 'normal',
};

export const ICONS: Partial<Record<Standing, IconName>> = { offline: 'offline', busy: 'busy', idle: 'idle' };

export function robotQuality(robot: Robot): Quality | null {
  return robot.quality === undefined ? null : qualityOf(robot.quality);
}
