import { expect, it } from 'vitest';
import { KNOWN_MS, Unanswered, isCommand, isDoneOnce, placeToLook } from './commands';

it('gives the same command the same key until it is answered, for a short time', () => {
  const unanswered = new Unanswered();
  const first = unanswered.key('start left', 0);
  expect(first.key).toMatch(/^[0-9a-f]{32}$/);
  expect(unanswered.key('start left', 0).key).not.toBe(first.key); // it was not lost: another press
  unanswered.lost('start left', first);
  expect(unanswered.key('start right', 2000).key).not.toBe(first.key);
  expect(unanswered.key('start left', 2000)).toBe(first);
  expect(unanswered.key('start left', 2000).key).not.toBe(first.key); // it was answered
  unanswered.lost('start left', first);
  expect(unanswered.key('start left', KNOWN_MS).key).not.toBe(first.key); // the console may have forgotten it
});

it('takes what it does not know for a command, and says where to look', () => {
  expect(['skill.start', 'run.abort', 'new.one'].map(isCommand)).toEqual([true, true, true]);
  expect(isCommand('node.read')).toBe(false);
  expect(placeToLook('skill.start')).toBe('errors.unknown_robot');
  expect(placeToLook('scenario.run')).toBe('errors.unknown_run');
  expect(placeToLook('constructor.x')).toBe('errors.unknown_other');
});

it('does again what stops or holds, and once what begins', () => {
  expect(['robots.hold', 'run.pause', 'run.abort', 'skill.halt', 'node.read'].map(isDoneOnce)).not.toContain(true);
  expect(['skill.start', 'scenario.run', 'run.tell_event', 'new.one'].map(isDoneOnce)).not.toContain(false);
});
