import { describe, expect, it } from 'vitest';
import { namesAsked, rehearsalOf } from './rehearsal';
import type { Outline, Step } from './types';

const task = (step: string, name: string): Step => ({
  ...{ step, line: 1, kind: 'task', name, skill: 'work', robot: null, capacities: [], after: [] },
});
const outline: Outline = {
  ...{ name: 'a', description: '', problems: [] },
  parameters: [{ name: 'limit', default: 1, unit: '', low: null, high: null, help: '' }],
  steps: [
    {
      ...{ step: '0', line: 1, kind: 'parallel' },
      steps: [
        { step: '0.0', line: 1, kind: 'sequence', steps: [task('0.0.0', 'one')] },
        { step: '0.1', line: 1, kind: 'sequence', steps: [task('0.1.0', 'two')] },
      ],
    },
    {
      step: '1',
      line: 1,
      kind: 'if',
      when: 'left.heat[1] > limit and not ready',
      then: [task('1.then.0', 'three')],
      else: [],
    },
    {
      step: '2',
      line: 1,
      kind: 'wait',
      for_s: null,
      until: "state == 'x y' or two.result < 3",
      event: null,
      timeout_s: null,
    },
    { step: '3', line: 1, kind: 'repeat', times: 2, while: null, steps: [task('3.repeat.0', 'again')] },
  ],
};

describe('rehearsalOf', () => {
  const { told, columns, bySteps, byRobots } = rehearsalOf(
    [
      { at_s: 0, step: '0.0.0', text: 'one: left work(to=dock)' },
      { at_s: 0, step: '0.1.0', text: 'two: arm 2 work()' },
      { at_s: 0, step: '0.0.0', text: 'done' },
      { at_s: 0, step: '0.1.0', text: 'done' },
      { at_s: 0, step: '1', text: 'the condition holds' },
      { at_s: 0, step: '1.then.0', text: 'three: left work()' },
      { at_s: 0, step: '1.then.0', text: 'done' },
      { at_s: 5, step: '3', text: 'repetition 1' },
      { at_s: 5, step: '3.repeat.0@0', text: 'again: left work()' },
      { at_s: 5, step: '3.repeat.0@0', text: 'refused' },
      { at_s: 5, step: '3.repeat.0@0', text: 'again: arm 2 work()' },
      { at_s: 6, step: '3', text: 'it is over' },
      { at_s: 6, step: '', text: 'the run is failed' },
    ],
    outline,
  );
  const spans = (lanes: typeof bySteps) =>
    lanes.map((lane) => [lane.title, ...lane.bars.map((bar) => `${bar.from}-${bar.to} ${bar.robot} ${bar.outcome}`)]);

  it('has what goes on together in one column, and a column for what follows or is later', () => {
    expect(columns).toEqual([0, 0, 5, 5, 6]);
    expect(spans(bySteps).map(([, ...bars]) => bars)).toEqual([
      ['0-0 left done'],
      ['0-0 arm 2 done'],
      ['1-1  '],
      ['1-1 left done'],
      ['2-2  ', '4-4  '],
      ['2-2 left refused', '3-4 arm 2 '],
    ]);
    expect(bySteps[0]?.bars[0]?.text).toBe('one · work(to=dock)');
    expect(bySteps[5]?.bars[0]?.text).toBe('again · 1 · work()');
  });
  it('tells the same by robots', () => {
    expect(spans(byRobots)).toEqual([
      ['left', '0-0 left done', '1-1 left done', '2-2 left refused'],
      ['arm 2', '0-0 arm 2 done', '3-4 arm 2 '],
    ]);
  });
  it('tells what each moment is', () => {
    expect(told.map((one) => one.kind)).toEqual([
      ...['begins', 'begins', 'over', 'over', 'decided', 'begins', 'over', 'decided', 'begins', 'over', 'begins'],
      ...['failed', 'ends'],
    ]);
    expect(rehearsalOf([{ at_s: 0, step: '9', text: 'x' }], null).bySteps[0]?.title).toBe('9');
  });
});

describe('namesAsked', () => {
  it('are those of conditions that are no parameters', () => {
    expect(namesAsked(outline)).toEqual(['left.heat[1]', 'ready', 'state', 'two.result']);
  });
});
