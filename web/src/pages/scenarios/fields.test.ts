import { describe, expect, it } from 'vitest';
import { parse } from 'yaml';
import { type Change, changed, fieldsOf, textOf } from './fields';
import { commentsOf } from './meaning';

const TEXT = `steps:
  # of one
  - {task: one, skill: work, robot: left, arguments: {to: "=a, b"}}   # behind one
  - task: two   # the second
    skill: work
    # within two
    capacity: weld   # who can
    arguments:
      # how long
      seconds: 0.50
      to: dock   # where
    after:
      - one
    retries: 2   # often

  - repeat:
      - {wait: 3}
      # the last one
    times: 2
  - if: one.done
    then: {end: failed}
  - wait:
    until: 'battery > 20'
  - end: done
    description: |
      Of two
      lines.
  - {
      task: three,   # three
      skill: work,   # what
      robot: left,
    }
# end
`;
const lineOf = (text: string | null, word: string) => text?.split('\n').filter((line) => line.includes(word));
const one = (path: string, key: string, value: Change['value'], argument?: string) =>
  changed(TEXT, path, [{ key, value, ...(argument === undefined ? {} : { argument }) }]);

describe('fieldsOf', () => {
  it('tells what a step says, and where', () => {
    const two = fieldsOf(TEXT, 'steps/1');
    expect([two?.kind, two?.line]).toEqual(['task', 4]);
    expect([...(two?.said ?? [])].map(([key, said]) => [key, said.text, said.line])).toEqual([
      ['task', 'two', 4],
      ['skill', 'work', 5],
      ['capacity', 'weld', 7],
      ['after', 'one', 12],
      ['retries', '2', 14],
    ]);
    expect(two?.given.get('seconds')).toEqual({ value: 0.5, text: '0.50', line: 10 });
    expect(fieldsOf(TEXT, 'steps/4')?.said.get('wait')?.value).toBeNull();
    expect(fieldsOf(TEXT, 'steps/3')?.strange).toEqual(['then']);
    expect(fieldsOf('steps:\n  - {tusk: a}', 'steps/0')).toBeNull();
  });
});

describe('changed', () => {
  it('replaces a value, and keeps what stands behind it', () => {
    expect(lineOf(one('steps/1', 'task', 'second'), 'task: second')).toEqual(['  - task: second   # the second']);
    expect(lineOf(one('steps/1', 'arguments', 2, 'seconds'), 'seconds')).toEqual(['      seconds: 2']);
    expect(lineOf(one('steps/0', 'arguments', '=b', 'to'), 'one,')?.[0]).toContain('{to: "=b"}}   # behind one');
    expect(lineOf(one('steps/4', 'wait', 2), 'wait: 2')).toEqual(['  - wait: 2']);
    expect(lineOf(one('steps/4', 'until', 'battery > 30'), 'until')).toEqual(['    until: "battery > 30"']);
    expect(one('steps/5', 'description', 'One line')).toContain('    description: One line\n  - {\n');
    expect(one('steps/1', 'after', ['one', 'three'])).toContain('    after: [one, three]\n    retries');
  });
  it('puts a key where its order has it', () => {
    expect(one('steps/1', 'on_unknown', 'fail')).toContain('    retries: 2   # often\n    on_unknown: fail\n');
    expect(one('steps/1', 'timeout_s', 1.5)).toContain('      - one\n    timeout_s: 1.5\n    retries');
    expect(one('steps/0', 'retries', 3)).toContain('{to: "=a, b"}, retries: 3}   # behind one');
    expect(one('steps/0', 'arguments', true, 'fast')).toContain('{to: "=a, b", fast: true}}');
    expect(one('steps/1', 'arguments', 'x y', 'more')).toContain('      to: dock   # where\n      more: x y\n');
    expect(one('steps/2', 'while', 'a < 3')).toContain('      # the last one\n    times: 2\n    while: a < 3\n');
    expect(one('steps/6', 'arguments', 1, 'seconds')).toContain('robot: left, arguments: {seconds: 1},\n');
    expect(changed('steps:\n  - wait: 1', 'steps/0', [{ key: 'timeout_s', value: 2 }])).toBe(
      'steps:\n  - wait: 1\n    timeout_s: 2\n',
    );
  });
  it('takes a key away, and keeps its comment', () => {
    expect(one('steps/1', 'retries', undefined)).toContain('      - one\n    # often\n');
    expect(one('steps/1', 'after', undefined)).toContain('# where\n    retries');
    expect(one('steps/1', 'arguments', undefined, 'to')).toContain('seconds: 0.50\n      # where\n    after');
    expect(lineOf(one('steps/0', 'arguments', undefined, 'to'), 'one,')?.[0]).toContain('robot: left}   # behind');
    expect(one('steps/6', 'robot', undefined)).toContain('      skill: work,   # what\n');
    const last = 'steps:\n  - task: a\n    skill: b\n    arguments:\n      # why\n      c: 1\n';
    expect(changed(last, 'steps/0', [{ key: 'arguments', argument: 'c', value: undefined }])).toBe(
      'steps:\n  - task: a\n    skill: b\n    # why\n',
    );
    expect(one('steps/1', 'timeout_s', undefined)).toBe(TEXT);
  });
  it('puts one key in the place of another', () => {
    const who = (path: string, key: string, value: string) =>
      changed(TEXT, path, [{ key, value, instead: ['robot', 'capacity', 'capacities'] }]);
    expect(lineOf(who('steps/1', 'robot', 'left'), '# who can')).toEqual(['    robot: left   # who can']);
    expect(lineOf(who('steps/0', 'capacity', 'weld'), 'one,')?.[0]).toContain('skill: work, capacity: weld, arg');
    expect(lineOf(who('steps/1', 'capacity', 'paint'), '# who can')).toEqual(['    capacity: paint   # who can']);
    const wait = changed(TEXT, 'steps/4', [
      { key: 'wait', value: 5, instead: ['until', 'event'] },
      { key: 'timeout_s', value: undefined },
    ]);
    expect(wait).toContain('  - wait: 5\n  - end: done');
  });
  it('refuses what would lose a comment or say something else', () => {
    const listed = 'steps:\n  - task: a\n    after:\n      - b   # why\n      - c\n';
    expect(changed(listed, 'steps/0', [{ key: 'after', value: ['b'] }])).toBeNull();
    expect(changed('steps:\n  - &x {task: a}\n  - *x', 'steps/0', [{ key: 'task', value: 'b' }])).toBeNull();
    expect(changed('steps:\n  - {task: a', 'steps/0', [{ key: 'task', value: 'b' }])).toBeNull();
  });
  const steps = (parse(TEXT) as { steps: Record<string, unknown>[] }).steps;
  it.each([...steps.keys()])(
    'leaves all other lines as they are, whatever is changed to whatever: step %i',
    (number) => {
      const values: Change['value'][] = [undefined, '=x # y: "z"', '\u0085\u2028 <', 1e30, ['a', 'b']];
      const keys: [string, string?][] = [...Object.keys(steps[number] ?? {}), 'timeout_s'].map((key) => [key]);
      let made = 0;
      for (const [key, argument] of [...keys, ['arguments', 'to'], ['arguments', 'new']] as [string, string?][]) {
        for (const value of values) {
          const after = changed(TEXT, `steps/${number}`, [{ key, value, ...(argument ? { argument } : {}) }]);
          if (after === null) continue;
          made += 1;
          expect(commentsOf(after).sort()).toEqual(commentsOf(TEXT).sort());
          const now = (parse(after) as { steps: unknown[] }).steps;
          expect(now.filter((_, at) => at !== number)).toEqual(steps.filter((_, at) => at !== number));
          const [from, to] = spanOf(number);
          expect(after.startsWith(TEXT.slice(0, from))).toBe(true);
          expect(after.endsWith(TEXT.slice(to))).toBe(true);
        }
      }
      expect(made).toBeGreaterThan(15);
    },
  );
});

/** Where a step of `TEXT` stands. */
function spanOf(number: number): [number, number] {
  const starts = [...TEXT.matchAll(/^ {2}- /gm)].map((found) => found.index);
  return [starts[number] ?? 0, starts[number + 1] ?? TEXT.length];
}

describe('textOf', () => {
  it('is read as that text by whoever reads YAML', () => {
    expect(['go', 'a < 3', 'no', '1', 'a: b', 'x #', '', '= a', 'ä', 'a '].map((one) => textOf(one))).toEqual([
      ...['go', 'a < 3', '"no"', '"1"', '"a: b"', '"x #"', '""', '"= a"', '"ä"', '"a "'],
    ]);
  });
});
