import { describe, expect, it } from 'vitest';
import { Rates, dropRows, formatRate, processesOf } from './health';
import { type Heard, type Span, hexOf, nodeOf, sectionsOf, selectedMessages, sourceOf, spanOfBytes } from './messages';

const bridge = (name: string, more: object = {}) => ({
  name,
  kind: 'ros2',
  space: 2,
  online: true,
  since: null,
  connected: { v: true, s: 0, t: null },
  detail: '',
  counters: { MessagesIn: 5, LagP99: { float: 'NaN' }, LastSeen: '2026-01-01T00:00:00Z' },
  drops: {},
  ...more,
});

const health = new Map<string, unknown>([
  ['server', { started: '2026-01-01T00:00:00Z' }],
  ['traffic', { MessagesIn: { int: '9007199254740993' }, Gaps: 0 }],
  ['drops', { repeated: 7, replayed: 2 }],
  ['causes', { repeated: { text: 'again', loss: false }, replayed: { text: 'used before', loss: true } }],
  ['bridge/a', bridge('a', { drops: { replayed: 3, new_cause: 1 } })],
  ['bridge/c', bridge('c', { connected: { v: true, s: 0x80310000, t: null } })],
  ['bridge/d', bridge('d', { connected: { v: false, s: 0, t: null } })],
  ['bridge/b', bridge('b', { online: false })],
]);

describe('processes', () => {
  const processes = processesOf(health);

  it('has the server first, and then what is not well', () => {
    expect(processes.map((one) => [one.name, one.standing])).toEqual([
      ['', 'server'],
      ['b', 'offline'],
      ['c', 'not_known'],
      ['d', 'not_connected'],
      ['a', 'connected'],
    ]);
  });

  it('counts as lost what somebody may miss, also for a cause that is new', () => {
    expect(processes.map((one) => one.lost)).toEqual([2, 0, 0, 0, 4]);
  });

  it('has the numbers of counters alone', () => {
    expect(Object.keys(processes[4]?.counters ?? {})).toEqual(['MessagesIn', 'LagP99']);
    expect(processes[0]?.counters.MessagesIn).toBeGreaterThan(9e15);
  });

  it('puts drops together by cause, losses first', () => {
    const rows = dropRows(processes, { repeated: { text: 'again', loss: false } });
    expect(rows.map((row) => [row.cause, row.total, row.loss])).toEqual([
      ['replayed', 5, true],
      ['new_cause', 1, true],
      ['repeated', 7, false],
    ]);
    expect(rows[0]?.where).toEqual([
      { name: 'a', count: 3 },
      { name: '', count: 2 },
    ]);
  });
});

describe('rates', () => {
  it('needs a second, and forgets what is long ago', () => {
    const rates = new Rates();
    rates.see('k', 100, 0);
    expect(rates.of('k', 500)).toBeNull();
    rates.see('k', 110, 1000);
    expect(rates.of('k', 1000)).toBe(10);
    for (let second = 2; second <= 20; second += 1) rates.see('k', 110, second * 1000);
    expect(rates.of('k', 20_000)).toBe(0);
    expect(rates.of('other', 0)).toBeNull();
  });

  it('goes down while a counter stands that is not told again', () => {
    const rates = new Rates();
    rates.see('k', 0, 0);
    rates.see('k', 10, 1000);
    expect(rates.of('k', 10_000)).toBe(1);
  });

  it('begins anew with a process that was started anew', () => {
    const rates = new Rates();
    rates.see('k', 100, 0);
    rates.see('k', 3, 1000);
    expect(rates.of('k', 1500)).toBeNull();
    rates.see('k', 5, 2000);
    expect(rates.of('k', 2000)).toBe(2);
  });

  it('has few digits', () => {
    expect([0, 0.25, 9.96, 12.4].map(formatRate)).toEqual(['0', '0.3', '10.0', '12']);
  });
});

const heard = (number: number, more: Partial<Heard> = {}): Heard => ({
  number,
  time: null,
  sent: false,
  address: '',
  size: 4,
  data: '',
  open: true,
  security: 'None',
  token: 0,
  chunks: false,
  dropped: [],
  publisher: '2',
  group: 2,
  writers: [1001],
  kind: 'key frame',
  ...more,
});

describe('messages', () => {
  const entries = new Map<string, Heard | number>([
    ['1', heard(1)],
    ['2', heard(2, { kind: 'keep-alive' })],
    ['3', heard(3, { dropped: ['repeated'] })],
    ['4', heard(4, { dropped: ['replayed'] })],
    ['lost', 5],
  ]);

  it('has the newest first, and what is wanted', () => {
    const numbers = (wish: '' | 'all' | 'dropped') => selectedMessages(entries, wish).map((one) => one.number);
    expect(numbers('all')).toEqual([4, 3, 2, 1]);
    expect(numbers('')).toEqual([4, 1]);
    expect(numbers('dropped')).toEqual([4, 3]);
  });

  it('names the source as everybody does', () => {
    expect(sourceOf(heard(1))).toBe('ua_2_2_1001');
    expect(sourceOf(heard(1, { writers: [1, 2, 3] }))).toBe('ua_2_2_1 +2');
    expect(sourceOf(heard(1, { publisher: 'press' }))).toBe('press');
    expect(sourceOf(heard(1, { group: null, writers: [] }))).toBe('2');
    expect(sourceOf(heard(1, { publisher: null }))).toBe('');
    expect(nodeOf(heard(1))).toBe('ns=2;i=1001');
    expect(nodeOf(heard(1, { writers: [1, 2] }))).toBeNull();
  });

  it('knows the span of each byte, and cuts those that reach beyond', () => {
    const span = (at: number, size: number, section = 'head'): Span => ({ at, size, section, name: '', text: '' });
    expect([...spanOfBytes(5, [span(0, 2), span(2, 1), span(4, 9)])]).toEqual([0, 0, 1, -1, 2]);
    const sections = sectionsOf([span(0, 1), span(1, 1), span(2, 1, 'body'), span(3, 1)]);
    expect(sections.map((one) => [one.name, one.spans.map(({ index }) => index)])).toEqual([
      ['head', [0, 1]],
      ['body', [2]],
      ['head', [3]],
    ]);
    expect(hexOf(Uint8Array.from([0, 171, 255]), 2)).toBe('00 ab …');
  });
});
