/** Alarms and events as the feeds tell them, in the order in which people want them. */
import type { Json } from '../../lib/protocol';

/** A fault of the feed `alarms`: active, or not yet acknowledged. */
export interface Alarm {
  id: string;
  robot: string;
  source: string;
  reason: string;
  capacities: string[];
  message: string;
  severity: number;
  active: boolean;
  acknowledged: boolean;
  since: string | null;
  time: string | null;
  comment: string;
  by: string;
}

/** An entry of the feed `events`. */
export interface ToldEvent {
  type: string;
  time: string | null;
  severity: number;
  message: string;
  source: string;
  node: string;
  audit: boolean;
  fields: Record<string, Json>;
}

/** What wants somebody first: active before over, unacknowledged before acknowledged, then severe, then new. */
export function sortedAlarms(alarms: Iterable<Alarm>): Alarm[] {
  const rank = (one: Alarm) => (one.active ? 0 : 2) + (one.acknowledged ? 1 : 0);
  return [...alarms].sort(
    (a, b) =>
      rank(a) - rank(b) ||
      b.severity - a.severity ||
      (b.since ?? '').localeCompare(a.since ?? '') ||
      a.id.localeCompare(b.id),
  );
}

/** Whether all words stand in one of the texts, whatever the case. */
export function matches(wanted: string, texts: readonly string[]): boolean {
  const text = texts.join('\n').toLowerCase();
  return wanted
    .toLowerCase()
    .split(/\s+/)
    .every((word) => text.includes(word));
}

export const alarmTexts = (one: Alarm) => [one.robot, one.source, one.reason, one.message, ...one.capacities];
export const eventTexts = (one: ToldEvent) => [one.type, one.message, one.source];

/** OPC 10000-5 6.4.2: 1 to 1000; the bands of UaExpert and of most alarm lists. */
export function severityBand(severity: number): 'high' | 'medium' | 'low' {
  return severity >= 667 ? 'high' : severity >= 334 ? 'medium' : 'low';
}

export type AuditWish = '' | 'only' | 'none';

export interface EventWish {
  text: string;
  type: string;
  audit: AuditWish;
}

export interface EventRow {
  key: string;
  event: ToldEvent;
}

/** The newest first. */
export function selectedEvents(events: ReadonlyMap<string, ToldEvent>, wish: EventWish): EventRow[] {
  const rows: EventRow[] = [];
  for (const [key, event] of events) {
    if (wish.type && event.type !== wish.type) continue;
    if ((wish.audit === 'only' && !event.audit) || (wish.audit === 'none' && event.audit)) continue;
    if (wish.text && !matches(wish.text, eventTexts(event))) continue;
    rows.push({ key, event });
  }
  return rows.sort((a, b) => (a.key < b.key ? 1 : -1));
}
