import { parse } from 'yaml';
import { describe, expect, it } from 'vitest';
import { FRAMES, taskText } from './palette';

describe('what is put in', () => {
  it('can be read', () => {
    for (const text of Object.values(FRAMES)) expect(Object.keys(parse(text) as object).length).toBeGreaterThan(0);
    const given = [
      { name: 'to', type: 'String' },
      { name: 'times', type: 'Int32', low: 1 },
      { name: 'speed', type: 'Double', default: 1 },
    ];
    expect(parse(taskText('a', 'go, back', { robot: '<x>' }, given))).toEqual({
      ...{ task: 'a', skill: 'go, back', robot: '<x>' },
      arguments: { to: '', times: 1 },
    });
    expect(taskText('a', 'go', { capacity: 'mobile' }, [])).toBe('{task: a, skill: go, capacity: mobile}');
  });
});
