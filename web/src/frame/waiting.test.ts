import { describe, expect, it } from 'vitest';
import { type Kind, newsOf, titleOf, waitingOf } from './waiting';

const counts = (alarms: number, decisions: number) => new Map<string, unknown>(Object.entries({ alarms, decisions }));

describe('what waits', () => {
  it('is told with its page, and whether that is of now', () => {
    expect(waitingOf(counts(1, 2), true).map((one) => [one.page, one.n, one.text])).toEqual([
      ['alarms', 1, '1 alarm to acknowledge'],
      ['resilience', 2, '2 open decisions'],
    ]);
    expect(waitingOf(counts(3, 0), false).map((one) => one.text)).toEqual(['3 alarms to acknowledge (not current)']);
    expect(waitingOf(new Map(), true)).toEqual([]);
  });

  it('stands in the title while it is of now', () => {
    const waiting = waitingOf(counts(3, 1), true);
    expect(titleOf('Fleet · Hall 1', waiting, true)).toBe('(4) Fleet · Hall 1');
    expect(titleOf('Fleet · Hall 1', waiting, false)).toBe('Fleet · Hall 1');
    expect(titleOf('Fleet · Hall 1', [], true)).toBe('Fleet · Hall 1');
  });

  it.each<[[Kind, number][], number, number, string]>([
    [[], 2, 0, '2 alarms to acknowledge'],
    [[['alarms', 2]], 2, 1, '1 open decision'],
    [[['alarms', 2]], 1, 0, ''],
    [[['alarms', 0]], 0, 0, ''],
  ])('after %j, %d and %d say %j', (before, alarms, decisions, said) =>
    expect(newsOf(new Map(before), waitingOf(counts(alarms, decisions), true))).toBe(said),
  );
});
