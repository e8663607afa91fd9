import { describe, expect, it } from 'vitest';
import { fieldsOf } from './fields';
import { type FieldKey, fieldKeys, fieldOf, problemsOf, type StepField, typedArgument, typedInto } from './form';

const TEXT = `steps:
  - {task: one, skill: go, robot: left, arguments: {to: 1}}
  - if: one.done
    then: [{task: two, skill: go, robot: left}, {wait: 1}]
  - repeat: {wait: 1}
    times: 0
`;
const found = (path: string, ...problems: [number, string][]) => {
  const fields = fieldsOf(TEXT, path);
  if (!fields) throw new Error(path);
  return Object.fromEntries(
    problemsOf(
      path,
      fields,
      problems.map(([line, message]) => ({ line, message })),
    ),
  );
};
const field = (kind: Parameters<typeof fieldOf>[0], key: FieldKey): StepField => {
  const one = fieldOf(kind, key);
  if (!one) throw new Error(key);
  return one;
};

describe('fieldOf', () => {
  it('is what the format says', () => {
    expect(fieldKeys('end').map((key) => field('end', key).control)).toEqual(['choice', 'text', 'text']);
    expect(field('task', 'on_unknown')).toMatchObject({
      choices: ['ask', 'retry', 'fail', 'replace'],
      left_out: 'ask',
    });
    const keys = ['retries', 'timeout_s', 'after'] as const;
    const controls = keys.map((key) => field('task', key).control);
    expect(controls).toEqual(['whole', 'seconds', 'names']);
    expect([field('if', 'if').control, field('repeat', 'times').control]).toEqual(['text', 'whole']);
    expect([fieldOf('task', 'who'), fieldOf('task', 'arguments')]).toEqual([null, null]);
  });
});

describe('what is typed', () => {
  it('is a value of the field', () => {
    expect(typedInto(field('task', 'retries'), '2')).toEqual({ value: 2 });
    expect(typedInto(field('task', 'retries'), '2.5')).toEqual({ error: 'Give a whole number.' });
    expect(typedInto(field('task', 'timeout_s'), '1,5')).toEqual({ value: 1.5 });
    expect(typedInto(field('task', 'timeout_s'), 'x')).toEqual({ error: 'Give a number.' });
    expect(typedInto(field('task', 'after'), 'a,, b ')).toEqual({ value: ['a', 'b'] });
    expect(typedInto(field('task', 'after'), '')).toEqual({ value: undefined });
    expect(typedInto(field('task', 'task'), ' ')).toEqual({ error: 'Give a value.' });
    expect(typedInto(field('wait', 'wait'), '')).toEqual({ value: null });
  });
  it('is a value of the argument, a number with its unit, or an expression', () => {
    const angle = { name: 'angle', type: 'Double', unit: 'deg', low: -90, high: 90 };
    expect(['20', '0.1 rad', '=a / 2', ''].map((one) => typedArgument(angle, one))).toEqual([
      { value: 20 },
      { value: '0.1 rad' },
      { value: '=a / 2' },
      { value: undefined },
    ]);
    expect(typedArgument(angle, '91')).toEqual({ error: 'Give -90 to 90.' });
    expect(typedArgument({ name: 'to', type: 'String' }, '5')).toEqual({ value: '5' });
    expect(typedArgument({ name: 'on', type: 'Boolean' }, 'true')).toEqual({ value: true });
    expect(typedArgument({ name: 'on', type: 'Boolean' }, '1')).toEqual({ error: 'Give true or false.' });
    expect(typedArgument(null, '5')).toEqual({ value: 5 });
  });
});

describe('problemsOf', () => {
  it('are at their fields, by the path', () => {
    expect(
      found(
        'steps/0',
        [2, "steps[0].arguments.to: '1 +' is no condition"],
        [2, 'steps[0].retries: `retries` must be a whole number'],
        [2, 'steps[0].robot: `robot` must be a text'],
        [2, "steps[0]: task 'one' needs either a `robot` or a `capacity`"],
        [2, 'steps[0].tusk: unknown key `tusk`; did you mean `task`?'],
        [5, 'steps[2].times: `times` must be a whole number'],
      ),
    ).toEqual({
      'arguments/to': ["'1 +' is no condition"],
      retries: ['`retries` must be a whole number'],
      who: ['`robot` must be a text', "task 'one' needs either a `robot` or a `capacity`"],
      '': ['unknown key `tusk`; did you mean `task`?'],
    });
    const below: [number, string] = [4, 'steps[1].then[1].wait: `wait` must be a number of seconds'];
    expect([found('steps/1', below), found('steps/1/then/1', below)]).toEqual([
      {},
      { wait: ['`wait` must be a number of seconds'] },
    ]);
  });
  it('are at their fields, by their words, where the fleet is what they do not fit', () => {
    expect(
      found(
        'steps/0',
        [2, "task 'one': left has no skill 'go'; did you mean `goto`?"],
        [2, "task 'one': there is no robot 'left'; known robots: `a`"],
        [2, "task 'one': the argument 'speed' of go is missing"],
        [2, "task 'one': to is 1; it has to be a text"],
        [2, "task 'one' comes after 'x', which is not there"],
        [2, "task 'other': left has no skill 'go'"],
        [3, "task 'one': left has no skill 'go'"],
      ),
    ).toEqual({
      skill: ["left has no skill 'go'; did you mean `goto`?"],
      who: ["there is no robot 'left'; known robots: `a`"],
      'arguments/speed': ["the argument 'speed' of go is missing"],
      'arguments/to': ['to is 1; it has to be a text'],
      after: ["task 'one' comes after 'x', which is not there"],
    });
    expect(found('steps/1', [3, "'one.done' is no parameter"], [3, 'is never reached: x'])).toEqual({
      if: ["'one.done' is no parameter"],
      '': ['is never reached: x'],
    });
  });
});
