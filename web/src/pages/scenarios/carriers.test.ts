import { expect, it } from 'vitest';
import { carrierState, openTasks } from './carriers';
import type { Carrier, Outline, Step, TaskRow } from './types';

const carrier = (more: Partial<Carrier>): Carrier => ({
  ...{ bridge: 'cell', state: 'answers', token: false, message: '' },
  ...more,
});

it.each([
  [{}, 'waits'],
  [{ token: true }, 'token'],
  [{ token: true, state: 'away' }, 'away'],
  [{ token: true, state: 'silent' }, 'silent'],
  [{ state: '' }, 'unknown'],
] as const)('shows a bridge of %o as %s', (more, state) => {
  expect(carrierState(carrier(more), false)).toBe(state);
  expect(carrierState(carrier(more), true)).toBe('over');
});

const step = (key: string, name: string, robot: string | null): Step => ({
  ...{ step: key, line: 1, kind: 'task', name, skill: 'work', robot, capacities: [], after: [] },
});
const outline: Outline = {
  ...{ name: 'a', description: '', parameters: [], problems: [] },
  steps: [
    step('0', 'done', 'left'),
    step('1', 'under way', 'left'),
    {
      ...{ step: '2', line: 1, kind: 'if', when: 'x > 1' },
      then: [{ step: '2.then', line: 1, kind: 'parallel', steps: [step('2.then.0', 'ahead', 'left')] }],
      else: [step('2.else.0', 'of another', 'right')],
    },
    { step: '3', line: 1, kind: 'repeat', times: 2, while: null, steps: [step('3.0', 'again', 'left')] },
    step('4', 'anybody', null),
  ],
};
const row = (key: string, task: string, state: TaskRow['state']): TaskRow => ({
  ...{ step: key, task, robot: 'left', skill: 'work', state, attempt: 1, result: {}, message: '' },
});

it('offers tasks of the bridge that may have been done, and none whose repetition nobody knows', () => {
  const tasks = [row('0', 'done', 'done'), row('1', 'under way', 'accepted'), row('3.0@0', 'again', 'accepted')];
  const found = openTasks(outline, tasks, (robot) => robot === 'left');
  expect(found.map((one) => one.step)).toEqual(['1', '3.0@0', '2.then.0', '4']);
});
