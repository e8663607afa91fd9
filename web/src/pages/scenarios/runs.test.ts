import { describe, expect, it } from 'vitest';
import {
  attemptsKept,
  attemptsOf,
  barOf,
  keepAttempts,
  labelPlaces,
  linesOf,
  mergedFacts,
  placeOf,
  repetitionOf,
  ticksOf,
  withEarlier,
} from './runs';
import type { Fact, Outline, TaskRow } from './types';

const task = (step: string, name: string, more: Partial<TaskRow> = {}): TaskRow => ({
  ...{ step, task: name, robot: 'left', skill: 'work', state: 'done', attempt: 1, result: {}, message: '' },
  ...more,
});
const outline: Outline = {
  name: 'a',
  description: '',
  parameters: [],
  problems: [],
  steps: [
    { step: '0', line: 4, kind: 'task', name: 'one', skill: 'work', robot: 'left', capacities: [], after: [] },
    {
      ...{ step: '1', line: 5, kind: 'repeat', times: 2, while: null },
      steps: [
        { step: '1.0', line: 5, kind: 'task', name: 'two', skill: 'work', robot: 'left', capacities: [], after: [] },
      ],
    },
    {
      ...{ step: '2', line: 6, kind: 'if', when: 'x > 1', else: [] },
      then: [{ step: '2.then.0', line: 7, kind: 'end', outcome: 'done', reason: '' }],
    },
  ],
};

describe('linesOf', () => {
  it('has each step where it stands, and a task with each of its repetitions', () => {
    const lines = linesOf(outline, [task('0', 'one'), task('1.0@0', 'two'), task('1.0@1', 'two')]);
    expect(lines.map((line) => [line.key, line.depth, line.tasks.length])).toEqual([
      ['0', 0, 1],
      ['1', 0, 0],
      ['1.0', 1, 2],
      ['2', 0, 0],
      ['2 then', 1, 0],
      ['2.then.0', 2, 0],
    ]);
  });
  it('has a branch of one step as that step', () => {
    const wait = { line: 1, kind: 'wait', for_s: 1, until: null, event: null, timeout_s: null } as const;
    const branch = (number: number, steps: number) => ({
      ...{ step: `0.${number}`, line: 1, kind: 'sequence' as const },
      steps: Array.from({ length: steps }, (_, at) => ({ step: `0.${number}.${at}`, ...wait })),
    });
    const steps = [{ step: '0', line: 1, kind: 'parallel' as const, steps: [branch(0, 1), branch(1, 2)] }];
    const found = linesOf({ ...outline, steps }, []).map((line) => [line.key, line.depth]);
    expect(found).toEqual([
      ['0', 0],
      ['0.0.0', 1],
      ['0.1', 1],
      ['0.1.0', 2],
      ['0.1.1', 2],
    ]);
  });
  it('has only the tasks where the text is another one now', () => {
    expect(linesOf(outline, [task('0', 'other')]).map((line) => line.step)).toEqual([null]);
    expect(linesOf(null, [task('0', 'one')])).toHaveLength(1);
  });
  it('counts repetitions from 1', () => {
    expect([placeOf('1.0@0@2'), repetitionOf('1.0@0@2'), repetitionOf('0')]).toEqual(['1.0', '1·3', '']);
  });
});

const assigned: Fact = {
  ...{ at: '2030-01-01T00:00:01Z', fact: 'TaskAssigned', task: 'one', robot: 'left' },
  detail: { step: '0', attempt: 1 },
};
const over: Fact = {
  ...{ at: '2030-01-01T00:00:03Z', fact: 'TaskOver', task: 'one', outcome: 'done' },
  detail: { step: '0', attempt: 1 },
};

describe('attemptsOf', () => {
  it('has the time from the assignment to the end', () => {
    const [one] = attemptsOf([assigned, over], []);
    expect(one).toMatchObject({ robot: 'left', outcome: 'done' });
    expect((one?.to ?? 0) - (one?.from ?? 0)).toBe(2000);
  });
  it('knows no beginning of what nobody saw begin', () => {
    expect(attemptsOf([over], [])).toMatchObject([{ from: null, outcome: 'done' }]);
    expect(attemptsOf([], [task('1', 'b', { state: 'accepted' })])).toMatchObject([{ from: null, to: null }]);
    expect(attemptsOf([], [task('1', 'b'), task('2', 'c', { state: 'wanted', robot: '' })])).toEqual([]);
  });
  it('has the times that the server keeps, of what nobody saw too', () => {
    const times = { begun: '2030-01-01T00:00:01Z', ended: '2030-01-01T00:00:03Z' };
    const [past] = attemptsOf([], [task('0', 'one', { ...times, state: 'failed' })]);
    expect(past).toMatchObject({ from: Date.parse(times.begun), to: Date.parse(times.ended), outcome: 'failed' });
    const [seen] = attemptsOf([{ ...over, outcome: 'timed_out' }], [task('0', 'one', { ...times, state: 'failed' })]);
    expect(seen).toMatchObject({ from: Date.parse(times.begun), outcome: 'timed_out' });
    const [now] = attemptsOf([], [task('0', 'one', { begun: times.begun, ended: null, state: 'accepted' })]);
    expect(now).toMatchObject({ from: Date.parse(times.begun), to: null, outcome: '' });
  });
  it('has a second attempt beside the first', () => {
    const again = { ...assigned, at: '2030-01-01T00:00:04Z', detail: { step: '0', attempt: 2 } };
    expect(attemptsOf([assigned, over, again], []).map((one) => one.to === null)).toEqual([false, true]);
  });
  it('has them in the order in which they began, whichever this page has seen', () => {
    const before = { begun: '2029-12-31T00:00:00Z', ended: '2029-12-31T00:00:09Z' };
    const tasks = [task('5', 'unseen', { state: 'accepted' }), task('4', 'before', before)];
    expect(attemptsOf([assigned, over], tasks).map((one) => one.task)).toEqual(['unseen', 'before', 'one']);
  });
});

describe('mergedFacts', () => {
  it('has each once, in the order of time', () => {
    expect(mergedFacts([over], [assigned, over])).toEqual([assigned, over]);
  });
});

describe('withEarlier', () => {
  const before = attemptsOf([assigned, over], []);
  it('has an attempt that the server does not keep any more', () => {
    const again = { ...assigned, at: '2030-01-01T00:00:04Z', detail: { step: '0', attempt: 2 } };
    expect(withEarlier(attemptsOf([again], []), before).map((one) => one.attempt)).toEqual([1, 2]);
    expect(withEarlier(before, before)).toEqual(before);
  });
  it('has none of which nobody saw the end', () => {
    expect(withEarlier([], attemptsOf([assigned], []))).toEqual([]);
  });
});

describe('attemptsKept', () => {
  it('has what was told of a run of a fleet, of the last 50 that were told of', () => {
    const [one, both] = [attemptsOf([assigned], []), attemptsOf([assigned, over], [])];
    keepAttempts('hall', 'first', one);
    for (let at = 0; at < 49; at += 1) keepAttempts('hall', `${at}`, []);
    expect(attemptsKept('hall', 'first')).toEqual(one);
    expect(attemptsKept('yard', 'first')).toEqual([]);
    keepAttempts('hall', 'first', both);
    keepAttempts('hall', 'last', []);
    expect(attemptsKept('hall', 'first')).toEqual(both);
    for (let at = 0; at < 50; at += 1) keepAttempts('hall', `later ${at}`, []);
    expect(attemptsKept('hall', 'first')).toEqual([]);
  });
});

describe('barOf', () => {
  const of = (from: number | null, to: number | null) =>
    barOf({ key: '', step: '', task: '', robot: '', attempt: 1, outcome: '', from, to }, 1000, 2000);
  it('keeps to the chart', () => {
    expect(of(1250, 1500)).toEqual({ left: 0.25, width: 0.25 });
    expect(of(null, null)).toEqual({ left: 0, width: 1 });
    expect(of(0, 9000)).toEqual({ left: 0, width: 1 });
  });
});

describe('labelPlaces', () => {
  const of = (...bars: [number, number][]) =>
    labelPlaces(
      bars.map(([left, width]) => ({ left, width })),
      0.1,
    );
  it('has a text in its bar, or beside it where nothing else stands', () => {
    expect(of([0, 0.1])).toEqual(['in']);
    expect(of([0, 0.02])).toEqual(['after']);
    expect(of([0.95, 0.05])).toEqual(['before']);
    expect(of([0.85, 0.02], [0.9, 0.05])).toEqual(['before', 'nowhere']);
    expect(of([0, 0.02], [0.15, 0.02], [0.2, 0.02])).toEqual(['after', 'nowhere', 'after']);
    expect(of([0.05, 0.02], [0.08, 0.9])).toEqual(['nowhere', 'in']);
  });
});

describe('ticksOf', () => {
  it('has few round times', () => {
    expect(ticksOf(10, 5)).toEqual([0, 2, 4, 6, 8, 10]);
    expect(ticksOf(0.3, 3)).toEqual([0, 0.1, 0.2, 0.3]);
    for (const span of [0.001, 1, 77, 5000, 1e7]) expect(ticksOf(span, 8).length).toBeLessThanOrEqual(9);
  });
});
