import { expect, it } from 'vitest';
import { MOST_WATCHED, formatWatched, parseWatched } from './watched';

it('comes back from the address', () => {
  const nodes = ['ns=2;s=a b,"c"', 'i=2259'];
  expect(parseWatched(formatWatched(nodes))).toEqual(nodes);
  expect(formatWatched([])).toBe('');
});

it('takes nothing that is no list of texts, none twice and not too many', () => {
  expect(parseWatched('{')).toEqual([]);
  expect(parseWatched('{"a":1}')).toEqual([]);
  expect(parseWatched('["i=1",2,"","i=1"]')).toEqual(['i=1']);
  expect(parseWatched(JSON.stringify(Array.from({ length: 99 }, (_, n) => `i=${n}`)))).toHaveLength(MOST_WATCHED);
});
