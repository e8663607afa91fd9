/** An entry of the feed `robots`. */
import type { Shown } from '../../lib/protocol';

export type RobotState = 'offline' | 'idle' | 'busy' | 'faulted';

export interface Fault {
  id: string;
  source: string;
  reason: string;
  since: string | null;
  acknowledged: boolean;
}

export interface Robot {
  state: Shown & { v: RobotState | null };
  bridge?: string;
  bridge_online?: boolean | null;
  capacities?: string[];
  task?: string;
  faults?: Fault[];
  held?: { by: string; since: string | null; reason: string } | null;
  values?: { good: number; uncertain: number; bad: number; never: number } | null;
  oldest?: string | null;
  marked?: (Shown & { name: string; label?: string })[];
}
