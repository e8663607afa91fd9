import { expect, it } from 'vitest';
import { type Alarm, type ToldEvent, matches, selectedEvents, severityBand, sortedAlarms } from './alarms';

const alarm = (id: string, more: Partial<Alarm> = {}): Alarm => ({
  ...{ id, robot: 'rover', source: 'x', reason: '', capacities: [], message: '', severity: 700 },
  ...{ active: true, acknowledged: false, since: '2026-01-01T00:00:00Z', time: null, comment: '', by: '' },
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
