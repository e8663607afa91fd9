import { expect, it } from 'vitest';
import { type NodeAttribute, displayName, isWritable, meaning } from './attributes';

const of = (name: string, v: NodeAttribute['v']): NodeAttribute => ({ name, v, s: 0 });

it.each([
  [3, true],
  [1, false],
  [null, false],
])('a UserAccessLevel of %j is writable: %j', (level, writable) => {
  expect(isWritable([of('DisplayName', 'x'), of('UserAccessLevel', level)])).toBe(writable);
});

it('says what numbers mean', () => {
  expect(meaning(of('UserAccessLevel', 3))).toBe('CurrentRead, CurrentWrite');
  expect(meaning(of('ValueRank', -1))).toBe('scalar');
  expect(meaning(of('ValueRank', 2))).toBe('2 dimensions');
  expect(meaning(of('NodeClass', 2))).toBe('');
  expect(displayName([of('DisplayName', 'Speed')])).toBe('Speed');
});
