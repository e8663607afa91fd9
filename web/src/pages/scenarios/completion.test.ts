import { describe, expect, it } from 'vitest';
import { namedAt, offersAt, tasksOf } from './completion';

const names = {
  robots: ['left', 'right'],
  capacities: ['weld'],
  skills: { work: ['seconds', 'work'] },
};
/** `|` is the cursor. */
function labels(marked: string): string[] {
  const at = marked.indexOf('|');
  return offersAt(marked.replace('|', ''), at, names)?.offers.map((one) => one.label) ?? [];
}
const HEAD = 'version: 1\nname: a\nsteps:\n';

describe('offersAt', () => {
  it('offers the keys of a file that are not there yet', () => {
    expect(labels('version: 1\n|')).toEqual(['name', 'description', 'parameters', 'steps']);
  });
  it('offers kinds where a step begins', () => {
    for (const step of ['  - |', '  - ta|', '  - {|']) expect(labels(HEAD + step)).toContain('task');
  });
  it('offers the keys of the step that are not there yet', () => {
    for (const step of ['  - {task: a, |}', '  - task: a\n    |', '  - task: a\n    |\n    robot: left\n']) {
      const found = labels(HEAD + step);
      expect(found).toContain('skill');
      expect(found).not.toContain('task');
      expect(found.includes('robot')).toBe(!step.includes('robot'));
      expect(found).not.toContain('times');
    }
    expect(labels(`${HEAD}  - task: a\n    skill: work\n  - repeat:\n      - {wait: 1}\n    |`)).toContain('times');
  });
  it('offers names of the fleet and of the text', () => {
    expect(labels(`${HEAD}  - {task: a, robot: |`)).toEqual(['left', 'right']);
    expect(labels(`${HEAD}  - {task: a, robot: left, skill: w|`)).toEqual(['work']);
    expect(labels(`${HEAD}  - {task: a}\n  - {task: b, after: [a, |`)).toEqual(['a', 'b']);
    expect(labels(`${HEAD}  - {task: a, on_unknown: |`)).toEqual(['ask', 'retry', 'fail', 'replace']);
    expect(labels(`${HEAD}  - {task: a, skill: work, robot: left, arguments: {|`)).toEqual(['seconds', 'work']);
  });
  it('offers nothing in a comment', () => {
    expect(labels(`${HEAD}  # task: |`)).toEqual([]);
  });
});

describe('namedAt', () => {
  it('reads the step around the cursor, of either form', () => {
    const flow = `${HEAD}  - {task: a, skill: work, robot: left}\n  - {task: b, robot: right}\n`;
    expect(namedAt(flow, flow.indexOf('skill'))).toEqual({ robot: 'left', capacity: '', skill: 'work' });
    const block = `${HEAD}  - task: a\n    skill: work\n    capacity: weld\n  - task: b\n    robot: right\n`;
    expect(namedAt(block, block.indexOf('skill:') + 8)).toEqual({ robot: '', capacity: 'weld', skill: 'work' });
    expect(namedAt(block, block.length - 2).robot).toBe('right');
  });
});

describe('tasksOf', () => {
  it('finds tasks in a text that cannot be read', () => {
    expect(tasksOf('- {task: a, [\n- task: "b"\n- {retask: c}')).toEqual(['a', 'b']);
  });
});
