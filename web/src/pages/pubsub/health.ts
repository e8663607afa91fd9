/** Processes of the fleet as the feed `health` tells them: what went through each, what was dropped, and how fast. */
import type { Json, Shown } from '../../lib/protocol';
import { numberOf, qualityOf } from '../../lib/value';

/** An entry `bridge/NAME`. */
export interface Bridge {
  name: string;
  kind: Json;
  space: Json;
  online: boolean;
  since: string | null;
  connected: Shown | null;
  detail: string;
  counters: Record<string, Json>;
  drops: Record<string, number>;
}

export interface Cause {
  text: string;
  /** Whether somebody may miss what was dropped so. */
  loss: boolean;
}

export type Standing = 'server' | 'connected' | 'not_connected' | 'not_known' | 'offline';

export interface Process {
  /** Empty: the server. */
  name: string;
  standing: Standing;
  kind: string;
  space: number | null;
  since: string | null;
  detail: string;
  counters: Record<string, number>;
  drops: Record<string, number>;
  /** Messages that somebody may miss. */
  lost: number;
}

/** Values that come later than this are not of now (ua_fleet.bridge.lag). */
export const MOST_LAG_MS = 1000;

type Entries = ReadonlyMap<string, unknown>;

function numbers(told: Record<string, Json>): Record<string, number> {
  const found: Record<string, number> = {};
  for (const [name, value] of Object.entries(told)) {
    const number = numberOf(value);
    if (number !== null) found[name] = number;
  }
  return found;
}

export function causesOf(entries: Entries): Record<string, Cause> {
  return (entries.get('causes') ?? {}) as Record<string, Cause>;
}

function lostOf(drops: Record<string, number>, causes: Record<string, Cause>): number {
  return Object.entries(drops).reduce((sum, [cause, count]) => sum + (causes[cause]?.loss === false ? 0 : count), 0);
}

function standingOf(bridge: Bridge): Standing {
  if (!bridge.online) return 'offline';
  if (!bridge.connected || qualityOf(bridge.connected.s) !== 'good') return 'not_known';
  return bridge.connected.v === true ? 'connected' : 'not_connected';
}

/** The server, then the bridges: those that are not well before the others, each by name. */
export function processesOf(entries: Entries): Process[] {
  const causes = causesOf(entries);
  const drops = (entries.get('drops') ?? {}) as Record<string, number>;
  const server: Process = {
    name: '',
    standing: 'server',
    kind: '',
    space: 0,
    since: ((entries.get('server') ?? {}) as { started?: string | null }).started ?? null,
    detail: '',
    counters: numbers((entries.get('traffic') ?? {}) as Record<string, Json>),
    drops,
    lost: lostOf(drops, causes),
  };
  const bridges: Process[] = [];
  for (const [key, value] of entries) {
    if (!key.startsWith('bridge/')) continue;
    const bridge = value as Bridge;
    bridges.push({
      name: bridge.name,
      standing: standingOf(bridge),
      kind: typeof bridge.kind === 'string' ? bridge.kind : '',
      space: numberOf(bridge.space),
      since: bridge.since,
      detail: bridge.detail,
      counters: numbers(bridge.counters),
      drops: bridge.drops,
      lost: lostOf(bridge.drops, causes),
    });
  }
  const rank = (one: Process) => (one.standing === 'connected' ? 1 : 0);
  bridges.sort((a, b) => rank(a) - rank(b) || a.name.localeCompare(b.name));
  return [server, ...bridges];
}

export interface DropRow {
  cause: string;
  text: string;
  loss: boolean;
  total: number;
  where: { name: string; count: number }[];
}

/** Drops of all processes by cause: what somebody may miss first, then the greatest numbers. */
export function dropRows(processes: readonly Process[], causes: Record<string, Cause>): DropRow[] {
  const rows = new Map<string, DropRow>();
  for (const process of processes) {
    for (const [cause, count] of Object.entries(process.drops)) {
      if (!count) continue;
      let row = rows.get(cause);
      if (!row) {
        const known = causes[cause];
        rows.set(cause, (row = { cause, text: known?.text ?? '', loss: known?.loss ?? true, total: 0, where: [] }));
      }
      row.total += count;
      row.where.push({ name: process.name, count });
    }
  }
  for (const row of rows.values()) row.where.sort((a, b) => b.count - a.count);
  return [...rows.values()].sort(
    (a, b) => Number(b.loss) - Number(a.loss) || b.total - a.total || a.cause.localeCompare(b.cause),
  );
}

const WINDOW_MS = 5000;

/** How fast counters grow, by what was seen of them within the last seconds. */
export class Rates {
  #seen = new Map<string, { at: number; count: number }[]>();

  /** Note a counter. What has become smaller belongs to a process that was started anew. */
  see(key: string, count: number, atMs: number): void {
    let seen = this.#seen.get(key);
    if (!seen) this.#seen.set(key, (seen = []));
    const last = seen.at(-1);
    if (last && (count < last.count || atMs - last.at > 2 * WINDOW_MS)) seen.length = 0;
    if (last && last.at === atMs) last.count = count;
    else seen.push({ at: atMs, count });
    while (seen.length > 2 && (seen[1]?.at ?? atMs) <= atMs - WINDOW_MS) seen.shift();
  }

  /** How much a second; null while that cannot be said. */
  of(key: string, nowMs: number): number | null {
    const seen = this.#seen.get(key);
    const first = seen?.[0];
    const last = seen?.at(-1);
    if (!first || !last || nowMs - first.at < 900) return null;
    // A counter that stands is told once: the time since counts too.
    return ((last.count - first.count) * 1000) / (nowMs - first.at);
  }
}

/** A rate in as many digits as it is worth. */
export function formatRate(rate: number): string {
  return rate === 0 || rate >= 10 ? String(Math.round(rate)) : rate.toFixed(1);
}
