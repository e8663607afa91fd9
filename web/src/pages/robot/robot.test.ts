import { describe, expect, it } from 'vitest';
import type { Json, Shown } from '../../lib/protocol';
import { Histories, History } from './history';
import {
  type DataNode,
  drawn,
  executionsOf,
  groupsOf,
  hasParts,
  isDrawn,
  leavesOf,
  resultsOf,
  writtenText,
} from './robot';

const about = (path: string[], more: Partial<DataNode> = {}): DataNode => ({
  path,
  folder: 'Data',
  type: 'Double',
  writable: false,
  history: false,
  description: '',
  unit: '',
  ...more,
});
const value = (v: Json, s = 0): Shown => ({ v, s, t: '2026-11-23T22:00:00Z' });

describe('data', () => {
  const entries = new Map<string, unknown>([
    ['robot', {}],
    ['data/s', about(['lidar', 'range'], { folder: 'Sensors', unit: 'm' })],
    ['value/s', value(2)],
    ['data/x', about(['pose', 'x'], { unit: 'm', description: 'along the hall' })],
    ['data/mode', about(['mode'])],
    ['data/y', about(['pose', 'y'])],
  ]);

  it('stand in the groups of the address space, sensors last', () => {
    const groups = groupsOf(entries, '');
    expect(groups.map((group) => [group.title, group.rows.map((row) => row.name)])).toEqual([
      ['', ['mode']],
      ['pose', ['x', 'y']],
      ['Sensors / lidar', ['range']],
    ]);
    expect(groups[2]?.rows[0]?.value?.u).toBe('m');
    expect(groups[0]?.rows[0]?.value).toBeUndefined();
  });

  it('have the same rows while nothing of them changes', () => {
    const rows = (all: ReadonlyMap<string, unknown>) => groupsOf(all, '').flatMap((group) => group.rows);
    const before = rows(entries);
    const after = rows(new Map(entries).set('value/s', value(3)));
    expect(after.map((row, place) => [row.name, row === before[place]])).toEqual([
      ['mode', true],
      ['x', true],
      ['y', true],
      ['range', false],
    ]);
    expect(after[3]?.value).toEqual({ ...value(3), u: 'm' });
    expect(rows(new Map(entries).set('data/s', about(['lidar', 'far'], { folder: 'Sensors' })))[3]?.name).toBe('far');
  });

  it.each([
    ['HALL pose', ['x']],
    ['lidar', ['range']],
    ['nothing', []],
  ])('are narrowed by %j', (words, expected) =>
    expect(groupsOf(entries, words).flatMap((group) => group.rows.map((row) => row.name))).toEqual(expected),
  );

  it.each<[Partial<DataNode>, boolean]>([
    [{ type: 'UInt16' }, true],
    [{ type: 'Int32', names: { '0': 'off' } }, false],
    [{ type: 'Double[]' }, false],
    [{ type: 'String' }, false],
  ])('%j are drawn: %j', (more, expected) => expect(isDrawn(about(['a'], more))).toBe(expected));

  it.each<[Shown | undefined, number | null]>([
    [value(1.5), 1.5],
    [value({ int: '9007199254740993' }), 9007199254740992],
    [value({ float: 'NaN' }), null],
    [value(1, 0x80310000), null],
    [value(1, 0x40900000), null],
    [undefined, null],
  ])('of %j a line has %j', (shown, expected) => expect(drawn(shown)).toBe(expected));

  it('have parts, each with its path', () => {
    const pose = { at: [1, { int: '12345678901234567890' }], name: '<b>\u202e\n', raw: { bytes: 4 }, none: [] };
    expect(leavesOf(pose, 9)).toEqual([
      { path: 'at[0]', text: '1' },
      { path: 'at[1]', text: '12345678901234567890' },
      { path: 'name', text: '<b>\\u202e\\u000a' },
      { path: 'raw', text: '4 bytes' },
    ]);
    expect(leavesOf([1, 2, 3], 2)).toHaveLength(2);
    expect([hasParts([1, 2]), hasParts([1]), hasParts({ bytes: 9, base64: 'AA' }), hasParts('ab')]).toEqual([
      true,
      false,
      false,
      false,
    ]);
  });

  it.each<[Json, string]>([
    ['a "b"', 'a "b"'],
    [1.5, '1.5'],
    [true, 'true'],
    [['a', 'b'], '["a","b"]'],
  ])('%j is written as %j', (given, expected) => expect(writtenText(given)).toBe(expected));
});

describe('executions', () => {
  it('stand with the newest first', () => {
    const entries = new Map<string, unknown>([
      ['execution/a', { execution: 'a', place: 0 }],
      ['robot', {}],
      ['execution/b', { execution: 'b', place: 1 }],
    ]);
    expect(executionsOf(entries).map((one) => one.execution)).toEqual(['b', 'a']);
  });

  it.each<[string, [string, Json][]]>([
    ['', []],
    [
      '{"x": 1, "y": [2]}',
      [
        ['x', 1],
        ['y', [2]],
      ],
    ],
    ['[1]', [['', '[1]']]],
    ['{x', [['', '{x']]],
  ])('have the results of %j', (text, expected) => expect(resultsOf(text)).toEqual(expected));
});

describe('a history', () => {
  it('has what held at each time, and gaps', () => {
    const history = new History();
    history.add(0, null);
    history.add(1000, 5);
    history.add(3000, null);
    history.add(4000, 7);
    history.add(4500, 7);
    expect(history.times).toEqual([1000, 3000, 4000]);
    expect(history.sampled(5000, 5000, 5)).toEqual([5, 5, null, 7, 7]);
    expect(history.sampled(600_000, 5000, 2)).toEqual([7, 7]);
  });

  it('forgets what is too old, and keeps what held', () => {
    const history = new History();
    [0, 1, 2, 3].forEach((one) => history.add(one * 1000, one));
    history.forget(2500);
    expect([history.times, history.values]).toEqual([
      [2000, 3000],
      [2, 3],
    ]);
    for (let at = 0; at < 30_000; at++) history.add(at * 100, at % 2);
    expect(history.times.length).toBeLessThanOrEqual(12_000);
  });

  it('begins anew after the link was away, with the same value too', () => {
    const all = new Histories();
    const entry = {};
    all.take(0, [['x', entry, () => 1]]);
    all.take(10, [['x', entry, () => 99]]);
    all.lose(20);
    all.take(30, [['x', entry, () => 1]]);
    expect([all.of.get('x')?.times, all.of.get('x')?.values]).toEqual([
      [0, 20, 30],
      [1, null, 1],
    ]);
  });
});
