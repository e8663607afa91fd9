/** Alarms and events as the feeds tell them, in the order in which people want them. */
import type { Json } from '../../lib/protocol';

export type AlarmKind = 'fault' | 'limit' | 'off_normal' | 'certificate' | 'dialog' | 'other';

/** A condition of the feed `alarms`: to be looked at, or put aside by a person. */
export interface Alarm {
  id: string;
  /** ConditionId, which its Methods are called of. */
  node: string;
  /** EventId of what is shown. */
  event: string;
  kind: AlarmKind;
  /** The robot that it is about; empty: something else. */
  robot: string;
  source: string;
  source_node: string;
  reason: string;
  capacities: string[];
  message: string;
  severity: number;
  /** Whether it is active, not acknowledged or not confirmed. */
  retained: boolean;
  active: boolean;
  acknowledged: boolean;
  /** null: it is not to be confirmed. */
  confirmed: boolean | null;
  enabled: boolean;
  suppressed: boolean;
  shelved: '' | 'timed' | 'one_shot';
  unshelve_at: string | null;
  limit: string;
  quality: number;
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

/** Whether a person has disabled, suppressed or shelved it. */
export const isPutAside = (one: Alarm): boolean => !one.enabled || one.suppressed || one.shelved !== '';

/** Whether it wants somebody. */
export const wants = (one: Alarm): boolean => one.retained && !isPutAside(one);

/** An alarm that there is, whatever its state, as the operation `alarm.list` tells it. */
export interface DeclaredAlarm {
  id: string;
  node: string;
  kind: AlarmKind;
  /** Whether it was disabled, suppressed or shelved then. */
  put_aside: boolean;
}

/** What the feed `alarms` has while it is not known whether its alarms are all. */
export const PARTIAL_KEY = 'partial';

/** The alarms of the feed, without what else it tells. */
export function alarmsOf(entries: ReadonlyMap<string, Alarm | true>): Map<string, Alarm> {
  const alarms = new Map(entries as ReadonlyMap<string, Alarm>);
  alarms.delete(PARTIAL_KEY);
  return alarms;
}

/** The declared alarms that are put aside and that the feed does not tell of: it reads the first ones alone. */
export function untoldAside(
  declared: readonly DeclaredAlarm[],
  told: ReadonlyMap<string, Alarm>,
): readonly DeclaredAlarm[] {
  return declared.filter((one) => one.put_aside && !told.has(one.node));
}

/**
 * The declared alarms that the feed does not tell, where that tells of all that want somebody: inactive, acknowledged, and
 * put aside by nobody. So all that is known of them is their names, and they have no event yet that somebody could
 * acknowledge or comment on.
 */
export function inactiveAlarms(declared: readonly DeclaredAlarm[], told: ReadonlyMap<string, Alarm>): Alarm[] {
  return declared
    .filter((one) => !one.put_aside && !told.has(one.node))
    .map(({ id, node, kind }) => ({
      ...{ id, node, kind, event: '', source: id, source_node: '', reason: '', capacities: [], message: '' },
      // Only values of robots have limits.
      ...{ robot: kind === 'limit' ? (id.split('.', 1)[0] ?? '') : '', severity: 1, retained: false, active: false },
      ...{ acknowledged: true, confirmed: null, enabled: true, suppressed: false, shelved: '' as const, limit: '' },
      ...{ unshelve_at: null, quality: 0, since: null, time: null, comment: '', by: '' },
    }));
}

/** Whether it is one of these. */
export const isQuiet = (one: Alarm): boolean => !one.event;

/** What the list can be narrowed to; empty: what wants somebody. */
// prettier-ignore
export const FILTERS =
  ['', 'active', 'new', 'unconfirmed', 'shelved', 'suppressed', 'disabled', 'inactive', 'all'] as const;
export type AlarmFilter = (typeof FILTERS)[number];

const PASSES: Record<AlarmFilter, (one: Alarm) => boolean> = {
  '': wants,
  active: (one) => one.enabled && one.active,
  new: (one) => one.enabled && !one.acknowledged,
  unconfirmed: (one) => one.enabled && one.acknowledged && one.confirmed === false,
  shelved: (one) => one.shelved !== '',
  suppressed: (one) => one.suppressed,
  disabled: (one) => !one.enabled,
  all: (one) => !isQuiet(one),
  inactive: isQuiet,
};

/** A filter of the page's address. */
export function filterOf(text: string): AlarmFilter {
  return FILTERS.find((one) => one === text) ?? '';
}

export interface AlarmWish {
  text: string;
  filter: AlarmFilter;
  /** An AlarmKind, or empty: any. */
  kind: string;
}

/** Alarms as they are wanted, what wants somebody first. */
export function selectedAlarms(alarms: Iterable<Alarm>, wish: AlarmWish): Alarm[] {
  return sortedAlarms(
    [...alarms].filter(
      (one) =>
        PASSES[wish.filter](one) &&
        (!wish.kind || one.kind === wish.kind) &&
        (!wish.text || matches(wish.text, alarmTexts(one))),
    ),
  );
}

/** How many alarms each filter leaves. */
export function filterCounts(alarms: Iterable<Alarm>): Record<AlarmFilter, number> {
  const all = [...alarms];
  const count = (filter: AlarmFilter) => all.filter(PASSES[filter]).length;
  return Object.fromEntries(FILTERS.map((one) => [one, count(one)])) as Record<AlarmFilter, number>;
}

/** Where an alarm is dealt with, or what it is about: a page with what follows its name; null: nowhere. */
export function placeOf(one: Alarm): { page: string; rest: string[] } | null {
  if (one.robot) return { page: 'robot', rest: [one.robot] };
  const [, decision] = /;s=Fleet\.Resilience\.Decisions\.(.+)$/.exec(one.source_node) ?? [];
  if (decision) return { page: 'resilience', rest: [decision] };
  const [, run] = /;s=Fleet\.Scenarios\.Runs\.(.+)$/.exec(one.source_node) ?? [];
  if (run) return { page: 'scenarios', rest: ['run', run] };
  return one.kind === 'off_normal' && !isQuiet(one) ? { page: 'pubsub', rest: [] } : null;
}

/** What events about it have in them. */
export const sourceOf = (one: Alarm): string => (one.kind === 'fault' ? one.robot : one.source);

export type Act =
  | 'acknowledge'
  | 'confirm'
  | 'comment'
  | 'clear'
  | 'shelve'
  | 'unshelve'
  | 'suppress'
  | 'unsuppress'
  | 'disable'
  | 'enable';

/** The operation of the console that does it, and the role that may. */
export const operationOf = (act: Act): string => (act === 'clear' ? 'fault.clear' : `alarm.${act}`);
export const roleOf = (act: Act): 'operator' | 'engineer' =>
  ['suppress', 'unsuppress', 'disable', 'enable'].includes(act) ? 'engineer' : 'operator';

/** What can be done with it now; what is most wanted first. */
export function actsOf(one: Alarm): Act[] {
  if (one.kind === 'dialog') return [];
  if (!one.enabled) return ['enable'];
  const acts: Act[] = [];
  if (!one.acknowledged) acts.push('acknowledge');
  else if (one.confirmed === false) acts.push('confirm');
  if (!isQuiet(one)) acts.push('comment');
  if (one.kind === 'fault') return one.active ? [...acts, 'clear'] : acts;
  return [...acts, one.shelved ? 'unshelve' : 'shelve', one.suppressed ? 'unsuppress' : 'suppress', 'disable'];
}

/** For how long an alarm can be shelved, in seconds. */
export const SHELVE_S = [300, 1800, 3600, 8 * 3600, 24 * 3600, 7 * 24 * 3600] as const;

/** What an act asks for. */
export function askedOf(act: Act, one: Alarm, comment: string, time_s: number | null): object {
  if (act === 'clear') return { fault: one.id };
  if (act === 'shelve') return { alarm: one.node, time_s };
  if (act === 'acknowledge' || act === 'confirm' || act === 'comment')
    return { alarm: one.node, event: one.event, comment };
  return { alarm: one.node };
}

/** What wants somebody first: active before over, unacknowledged before acknowledged, then severe, then new. */
export function sortedAlarms(alarms: Iterable<Alarm>): Alarm[] {
  const rank = (one: Alarm) => (isPutAside(one) ? 4 : 0) + (one.active ? 0 : 2) + (one.acknowledged ? 1 : 0);
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

export const alarmTexts = (one: Alarm) => [
  ...[one.id, one.robot, one.source, one.reason, one.message, one.comment, ...one.capacities],
];
export const eventTexts = (one: ToldEvent) => [one.type, one.message, one.source];

/** What an event says of the state of a condition, in the server's words; empty: it is about none. */
export function conditionState({ fields }: ToldEvent): string {
  const words = ['EnabledState', 'ActiveState', 'AckedState', 'ConfirmedState', 'SuppressedState'].map(
    (name) => fields[name],
  );
  const shelving = fields['ShelvingState/CurrentState'];
  return [...words, shelving]
    .filter((word): word is string => typeof word === 'string' && !USUAL.has(word))
    .join(' · ');
}

const USUAL = new Set(['Enabled', 'Confirmed', 'Unsuppressed', 'Unshelved']);

/** OPC 10000-5 6.4.2: 1 to 1000; the bands of UaExpert and of most alarm lists. */
export function severityBand(severity: number): 'high' | 'medium' | 'low' {
  return severity >= 667 ? 'high' : severity >= 334 ? 'medium' : 'low';
}

export type AuditWish = '' | 'only' | 'none';

/** What became of the server's history of events, with which the list begins; under the key `history` of the feed. */
export interface EventHistory {
  state: 'loading' | 'read' | 'none' | 'refused' | 'failed';
  /** Of `read`: from when on events were read. */
  since: string | null;
  /** Events that the feed keeps. */
  most: number;
  /** Of `refused` and `failed`: what the server says. */
  reason: string;
}

export const HISTORY_KEY = 'history';

/** The events of the feed, without what else it tells. */
export function eventsOf(entries: ReadonlyMap<string, ToldEvent | EventHistory>): Map<string, ToldEvent> {
  const events = new Map(entries as ReadonlyMap<string, ToldEvent>);
  events.delete(HISTORY_KEY);
  return events;
}

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
