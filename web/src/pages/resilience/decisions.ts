/** Decisions and rankings as the feeds tell them. */
import type { Json } from '../../lib/protocol';
import { t } from '../../lib/texts';
import { numberOf } from '../../lib/value';

export interface Ranking {
  criteria: { name: string; weight: Json }[];
  ratio: Json;
  robots: { robot: string; score: Json; values: { raw: Json; score: Json; missing: string }[] }[];
  excluded: { robot: string; reason: string }[];
}

export interface DecisionHead {
  id: string;
  state: string;
  run: string;
  step: string;
  task: string;
  failed: string;
  reason: string;
  chosen: string;
  by: string;
  /** When it was opened, by the server's clock. */
  started: string | null;
  /** When it is decided without a person, by the server's clock; null: it is not open, or nobody knows. */
  deadline: string | null;
}

export interface ListedDecision extends DecisionHead {
  candidates: number;
  best: { robot: string; score: Json }[];
}

export interface Decision extends DecisionHead {
  ranking: Ranking;
}

export interface Settings {
  mode: string;
  limit_s: Json;
  on_limit: string;
  synthesis: string;
  ratio: Json;
  criteria: { name: string; weight: Json; unit: string }[];
  judgements: Record<string, number>;
}

export interface Preview {
  ranking: Ranking | null;
  ratio: Json;
  problem: string;
}

/** Saaty: judgements above this contradict each other too much. */
export const MOST_INCONSISTENT = 0.1;

const number = (value: Json) => numberOf(value) ?? 0;

/** Seconds until a time of the server's clock; `now_ms` of the console's. */
export function leftUntil(deadline: string, now_ms: number, ahead_s: number): number {
  return (Date.parse(deadline) - now_ms) / 1000 - ahead_s;
}

/** Open ones first, then the newest: their ids rise. */
export function sortedDecisions(decisions: Iterable<ListedDecision>): ListedDecision[] {
  return [...decisions].sort(
    (a, b) =>
      Number(b.state === 'open') - Number(a.state === 'open') || b.id.localeCompare(a.id, undefined, { numeric: true }),
  );
}

/** The open decision that is shown to who has chosen none: the one that was, else the first; empty: none is open. */
export function openDecision(decisions: readonly ListedDecision[], shown: string): string {
  const open = decisions.filter((one) => one.state === 'open');
  return (open.find((one) => one.id === shown) ?? open[0])?.id ?? '';
}

/** What each criterion adds to a robot's score, as a part of the best score: the lengths of a bar. */
export function partsOf(ranking: Ranking, at: number): { name: string; part: number; missing: string }[] {
  const best = Math.max(...ranking.robots.map((one) => number(one.score)), 0);
  const robot = ranking.robots[at];
  const shares = (robot?.values ?? []).map((value, index) => {
    const weight = number(ranking.criteria[index]?.weight ?? 0);
    return weight * number(value.score);
  });
  const sum = shares.reduce((all, one) => all + one, 0);
  const whole = best > 0 ? number(robot?.score ?? 0) / best : 0;
  return shares.map((share, index) => ({
    name: ranking.criteria[index]?.name ?? '',
    part: sum > 0 ? (share / sum) * whole : 0,
    missing: robot?.values[index]?.missing ?? '',
  }));
}

const BY_ITSELF = { automatic: 'taken_automatic', back: 'taken_back', limit: 'taken_limit' } as const;
const isByItself = (by: string): by is keyof typeof BY_ITSELF => Object.hasOwn(BY_ITSELF, by);

/** Which robot was chosen, and by whom or why. */
export const takenText = ({ chosen: robot, by }: Pick<DecisionHead, 'chosen' | 'by'>): string =>
  isByItself(by) ? t(`resilience.${BY_ITSELF[by]}`, { robot }) : t('resilience.taken', { robot, by: by || '—' });

/** Units of the criteria by their names; of one that the fleet does not have any more nobody knows it. */
export const unitsOf = (settings: Settings | undefined): Readonly<Record<string, string>> =>
  Object.fromEntries((settings?.criteria ?? []).map((one) => [one.name, one.unit]));

export const percent = (value: Json) => `${(100 * number(value)).toFixed(1)} %`;
