import { expect, it } from 'vitest';
import { formatPlace, parsePlace, type Place } from './places';

it.each<Place>([
  { fleet: 'hall', page: 'fleet', rest: [], query: {} },
  { fleet: 'hall', page: 'robot', rest: ['arm/2 ä#?'], query: { tab: 'data', q: 'a&b=c' } },
])('an address is what it was made from: %j', (place) => {
  expect(parsePlace(formatPlace(place))).toEqual(place);
});

it('what is typed by hand is no error', () => {
  expect(parsePlace('')).toEqual({ fleet: '', page: '', rest: [], query: {} });
  expect(parsePlace('#hall//fleet/%E0%A4%A')).toEqual({ fleet: 'hall', page: 'fleet', rest: ['%E0%A4%A'], query: {} });
});
