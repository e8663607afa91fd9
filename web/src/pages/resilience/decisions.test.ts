import { expect, it } from 'vitest';
import {
  type ListedDecision,
  type Ranking,
  type Settings,
  leftUntil,
  openDecision,
  partsOf,
  percent,
  sortedDecisions,
  takenText,
  unitsOf,
} from './decisions';

const RANKING: Ranking = {
  criteria: [
    { name: 'battery', weight: 0.75 },
    { name: 'distance', weight: 0.25 },
  ],
  ratio: 0,
  robots: [
    {
      robot: 'a',
      score: 0.6,
      values: [
        { raw: 80, score: 0.6, missing: '' },
        { raw: 2, score: 0.6, missing: '' },
      ],
    },
    {
      robot: 'b',
      score: 0.3,
      values: [
        { raw: 40, score: 0.4, missing: '' },
        { raw: null, score: 0, missing: 'silent' },
      ],
    },
  ],
  excluded: [],
};

it('shares a score among the criteria, as a part of the best one', () => {
  expect(partsOf(RANKING, 0).map((one) => one.part)).toEqual([0.75, 0.25]);
  const second = partsOf(RANKING, 1);
  expect(second.map((one) => one.part)).toEqual([0.5, 0]);
  expect(second[1]?.missing).toBe('silent');
  expect(partsOf({ ...RANKING, robots: [] }, 0)).toEqual([]);
});

it('counts down by the clock of the server', () => {
  const now = Date.parse('2030-01-01T00:00:00Z');
  expect(leftUntil('2030-01-01T00:01:00Z', now, 0)).toBe(60);
  expect(leftUntil('2030-01-01T00:01:00Z', now, 3600)).toBe(-3540);
  expect(leftUntil('2030-01-01T00:01:00Z', now, -30)).toBe(90);
});

it('puts open decisions first, then the newest', () => {
  const of = (id: string, state: string) => ({ id, state }) as ListedDecision;
  const sorted = sortedDecisions([of('9', 'taken'), of('10', 'taken'), of('3', 'open')]);
  expect(sorted.map((one) => one.id)).toEqual(['3', '10', '9']);
  expect(percent(0.1234)).toBe('12.3 %');
});

it('knows the units of the criteria that there are', () => {
  const criteria = [
    { name: 'battery', weight: 0.75, unit: '%' },
    { name: 'availability', weight: 0.25, unit: '' },
  ];
  expect(unitsOf({ criteria } as Settings)).toEqual({ battery: '%', availability: '' });
  expect(unitsOf(undefined)).toEqual({});
});

it('says who has chosen a robot, or why it was taken by itself', () => {
  expect(takenText({ chosen: 'left', by: 'anna' })).toBe('left, chosen by anna');
  expect(takenText({ chosen: 'left', by: '' })).toBe('left, chosen by —');
  expect(takenText({ chosen: 'left', by: 'automatic' })).toBe('left, chosen by the server');
  expect(takenText({ chosen: 'left', by: 'back' })).toBe('left again: it can do it now');
  expect(takenText({ chosen: 'left', by: 'limit' })).toBe('left, the best when the time to decide was over');
});

it('stays at the decision that is shown while it is open', () => {
  const one = (id: string, state = 'open') => ({ id, state }) as ListedDecision;
  expect(openDecision([one('2'), one('1')], '')).toBe('2');
  expect(openDecision([one('2'), one('1')], '1')).toBe('1');
  expect(openDecision([one('2'), one('1', 'taken')], '1')).toBe('2');
  expect(openDecision([one('1', 'taken')], '1')).toBe('');
});
