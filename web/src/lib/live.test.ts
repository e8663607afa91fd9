import { describe, expect, it } from 'vitest';
import { backoffMs } from './backoff';
import { applyChange } from './entries';
import type { Json } from './protocol';

describe('the map of a feed', () => {
  it('follows what was set and what is gone, and begins anew', () => {
    const entries = new Map<string, Json>([['old', 0]]);
    applyChange(entries, { whole: true, set: { a: 1, b: 2 } });
    expect([...entries]).toEqual([
      ['a', 1],
      ['b', 2],
    ]);
    applyChange(entries, { set: { b: 3 }, gone: ['a', 'never'] });
    expect([...entries]).toEqual([['b', 3]]);
    // What is gone and set in one message is there.
    applyChange(entries, { set: { b: 4 }, gone: ['b'] });
    expect([...entries]).toEqual([['b', 4]]);
  });

  it('makes an entry of what it was and what has changed of it', () => {
    const entries = new Map<string, Json>();
    const state = { v: 'idle', s: 0 };
    applyChange(entries, { whole: true, set: { arm: { state, at: 1 } } });
    const before = entries.get('arm');
    applyChange(entries, { part: { arm: { at: 2 } } });
    expect(entries.get('arm')).toEqual({ state, at: 2 });
    // Another object, so that it is seen to have changed; what is the same in it is the same object.
    expect(before).toEqual({ state, at: 1 });
    expect((entries.get('arm') as { state: Json }).state).toBe(state);
  });

  it('takes names that objects have of their own', () => {
    const entries = new Map<string, Json>();
    applyChange(entries, JSON.parse('{"set": {"__proto__": 1, "constructor": 2}}'));
    expect([...entries.keys()]).toEqual(['__proto__', 'constructor']);
  });
});

describe('waiting for the next attempt', () => {
  it('grows to 10 s, and is never nothing', () => {
    expect(backoffMs(1, 1)).toBe(500);
    expect(backoffMs(1, 0)).toBe(125);
    expect(backoffMs(4, 1)).toBe(4000);
    expect(backoffMs(40, 1)).toBe(10_000);
    expect(backoffMs(5000, 0)).toBe(2500);
  });
});
