import { expect, it } from 'vitest';
import {
  type Alarm,
  type ToldEvent,
  actsOf,
  alarmsOf,
  askedOf,
  conditionState,
  eventsOf,
  filterCounts,
  inactiveAlarms,
  matches,
  placeOf,
  selectedAlarms,
  selectedEvents,
  severityBand,
  sortedAlarms,
  untoldAside,
} from './alarms';

const alarm = (id: string, more: Partial<Alarm> = {}): Alarm => ({
  ...{ id, node: `ns=2;s=Alarms.${id}`, event: 'ab', kind: 'limit', robot: 'rover', source: 'x', source_node: '' },
  ...{ reason: '', capacities: [], message: '', severity: 700, retained: true, active: true, acknowledged: false },
  ...{ confirmed: null, enabled: true, suppressed: false, shelved: '', unshelve_at: null, limit: 'High', quality: 0 },
  ...{ since: '2026-01-01T00:00:00Z', time: null, comment: '', by: '' },
  ...more,
});

it('puts first what wants somebody', () => {
  const alarms = [
    alarm('over', { active: false }),
    alarm('known', { acknowledged: true }),
    alarm('mild', { severity: 100 }),
    alarm('old'),
    alarm('new', { since: '2026-01-02T00:00:00Z' }),
  ];
  expect(sortedAlarms(alarms).map((one) => one.id)).toEqual(['new', 'old', 'mild', 'known', 'over']);
});

const MANY = [
  alarm('new'),
  alarm('seen', { acknowledged: true }),
  alarm('over', { active: false, acknowledged: true, confirmed: false }),
  alarm('shelved', { shelved: 'timed' }),
  alarm('suppressed', { suppressed: true, active: false, acknowledged: true, retained: false }),
  alarm('disabled', { enabled: false, retained: false, kind: 'off_normal' }),
];

it.each([
  ['', ['new', 'seen', 'over']],
  ['active', ['new', 'seen', 'shelved']],
  ['new', ['new', 'shelved']],
  ['unconfirmed', ['over']],
  ['shelved', ['shelved']],
  ['suppressed', ['suppressed']],
  ['disabled', ['disabled']],
  ['inactive', []],
  ['all', ['new', 'seen', 'over', 'disabled', 'shelved', 'suppressed']],
] as const)('filter %s leaves what it says, what wants somebody first', (filter, ids) => {
  expect(selectedAlarms(MANY, { text: '', filter, kind: '' }).map((one) => one.id)).toEqual(ids);
  expect(filterCounts(MANY)[filter]).toBe(ids.length);
});

it('selects by kind and words', () => {
  const found = (text: string, kind: string) =>
    selectedAlarms(MANY, { text, filter: 'all', kind }).map((one) => one.id);
  expect(found('', 'off_normal')).toEqual(['disabled']);
  expect(found('SEEN rover', '')).toEqual(['seen']);
});

it('offers what can be done now', () => {
  expect(actsOf(alarm('a'))).toEqual(['acknowledge', 'comment', 'shelve', 'suppress', 'disable']);
  expect(actsOf(alarm('a', { acknowledged: true, confirmed: false }))[0]).toBe('confirm');
  expect(actsOf(alarm('a', { enabled: false, shelved: 'timed' }))).toEqual(['enable']);
  expect(actsOf(alarm('a', { shelved: 'one_shot', suppressed: true })).slice(2, 4)).toEqual(['unshelve', 'unsuppress']);
  expect(actsOf(alarm('a', { kind: 'fault', acknowledged: true }))).toEqual(['comment', 'clear']);
  expect(actsOf(alarm('a', { kind: 'dialog' }))).toEqual([]);
});

it('asks by ConditionId and EventId', () => {
  const one = alarm('a');
  expect(askedOf('confirm', one, 'ok', null)).toEqual({ alarm: 'ns=2;s=Alarms.a', event: 'ab', comment: 'ok' });
  expect(askedOf('shelve', one, '', null)).toEqual({ alarm: 'ns=2;s=Alarms.a', time_s: null });
  expect(askedOf('disable', one, '', 5)).toEqual({ alarm: 'ns=2;s=Alarms.a' });
  expect(askedOf('clear', one, '', null)).toEqual({ fault: 'a' });
});

it('leads to what an alarm is about', () => {
  const away = { robot: '', kind: 'off_normal' } as const;
  expect(placeOf(alarm('a'))).toEqual({ page: 'robot', rest: ['rover'] });
  expect(placeOf(alarm('a', away))).toEqual({ page: 'pubsub', rest: [] });
  const dialog = (source_node: string) => placeOf(alarm('a', { robot: '', kind: 'dialog', source_node }));
  expect(dialog('ns=2;s=Fleet.Resilience.Decisions.r.1.0')).toEqual({ page: 'resilience', rest: ['r.1.0'] });
  expect(dialog('ns=2;s=Fleet.Scenarios.Runs.r.1')).toEqual({ page: 'scenarios', rest: ['run', 'r.1'] });
  expect(placeOf(alarm('a', { robot: '', kind: 'certificate' }))).toBeNull();
});

it('tells of a condition what is not as usual', () => {
  const told = (fields: ToldEvent['fields']) =>
    conditionState({ type: '', time: null, severity: 1, message: '', source: '', node: '', audit: false, fields });
  expect(told({ EnabledState: 'Enabled', ActiveState: 'Active', AckedState: 'Unacknowledged' })).toBe(
    'Active · Unacknowledged',
  );
  expect(told({ RunId: 'r.1' })).toBe('');
});

it('finds all words wherever they stand', () => {
  expect(matches('ROVER arm', ['the arm', 'rover'])).toBe(true);
  expect(matches('rover leg', ['the arm', 'rover'])).toBe(false);
  expect(matches('', [])).toBe(true);
});

it.each([
  [1000, 'high'],
  [667, 'high'],
  [666, 'medium'],
  [333, 'low'],
])('severity %d is %s', (severity, band) => {
  expect(severityBand(severity)).toBe(band);
});

it('selects events, the newest first', () => {
  const event = (type: string, audit = false): ToldEvent => ({
    ...{ type, audit, time: null, severity: 1, message: `${type} told`, source: 'Server', node: '', fields: {} },
  });
  const events = new Map([
    ['1', event('Fault')],
    ['2', event('AuditSession', true)],
    ['3', event('Fault')],
  ]);
  const keys = (wish: Parameters<typeof selectedEvents>[1]) => selectedEvents(events, wish).map((row) => row.key);
  expect(keys({ text: '', type: '', audit: '' })).toEqual(['3', '2', '1']);
  expect(keys({ text: '', type: 'Fault', audit: '' })).toEqual(['3', '1']);
  expect(keys({ text: 'session', type: '', audit: 'only' })).toEqual(['2']);
  expect(keys({ text: '', type: '', audit: 'none' })).toEqual(['3', '1']);
});

it('takes the alarms that are told away from all that there are', () => {
  const declared = [
    { id: 'rover.speed', node: 'ns=2;s=Alarms.rover.speed', kind: 'limit' as const, put_aside: false },
    { id: 'cell.Online', node: 'ns=2;s=Alarms.cell.Online', kind: 'off_normal' as const, put_aside: false },
    { id: 'new', node: 'ns=2;s=Alarms.new', kind: 'limit' as const, put_aside: false },
  ];
  const quiet = inactiveAlarms(declared, new Map([['ns=2;s=Alarms.new', alarm('new')]]));
  expect(selectedAlarms(quiet, { text: '', filter: 'inactive', kind: '' }).map((one) => one.id)).toEqual([
    'cell.Online',
    'rover.speed',
  ]);
  expect(quiet.map(actsOf)).toEqual([
    ['shelve', 'suppress', 'disable'],
    ['shelve', 'suppress', 'disable'],
  ]);
  expect(quiet.map(placeOf)).toEqual([{ page: 'robot', rest: ['rover'] }, null]);
  expect(selectedAlarms(quiet, { text: '', filter: 'all', kind: '' })).toEqual([]);
});

it('takes for inactive no alarm that is put aside, told or not', () => {
  const declared = ['told', 'untold', 'quiet'].map((id) => ({
    ...{ id, node: `ns=2;s=Alarms.${id}`, kind: 'limit' as const, put_aside: id !== 'quiet' },
  }));
  const told = new Map([['ns=2;s=Alarms.told', alarm('told', { enabled: false })]]);
  expect(inactiveAlarms(declared, told).map((one) => one.id)).toEqual(['quiet']);
  expect(untoldAside(declared, told).map((one) => one.id)).toEqual(['untold']);
});

it('takes that there may be more alarms for none of them', () => {
  const entries = new Map<string, Alarm | true>([
    ['partial', true],
    ['ns=2;s=Alarms.a', alarm('a')],
  ]);
  expect([...alarmsOf(entries).values()].map((one) => one.id)).toEqual(['a']);
});

it('takes what became of the history for no event', () => {
  const history = { state: 'none' as const, since: null, most: 500, reason: '' };
  expect([...eventsOf(new Map([['history', history]])).keys()]).toEqual([]);
});
