/** Pairwise comparisons of criteria, as the Analytic Hierarchy Process has them (Saaty's scale, 1/9 to 9). */

/** By pair, as `battery/distance`: how many times more the first one counts than the second. */
export type Judgements = Readonly<Record<string, number>>;

export interface Pair {
  name: string;
  left: string;
  right: string;
}

/** Each pair of criteria once, in the order of the criteria. */
export function pairsOf(criteria: readonly string[]): Pair[] {
  return criteria.flatMap((left, at) =>
    criteria.slice(at + 1).map((right) => ({ name: `${left}/${right}`, left, right })),
  );
}

/** What is judged of a pair, whichever of the two stands first; 1 where nobody has judged. */
export function judged(judgements: Judgements, pair: Pair): number {
  const given = judgements[pair.name];
  if (given !== undefined) return given;
  const other = judgements[`${pair.right}/${pair.left}`];
  return other ? 1 / other : 1;
}

/** Steps of a slider: -8 is 1/9, 0 is 1, 8 is 9. */
export const FURTHEST = 8;

export function stepOf(value: number): number {
  const step = value >= 1 ? value - 1 : 1 - 1 / value;
  return Math.max(-FURTHEST, Math.min(FURTHEST, Math.round(step)));
}

export function valueOf(step: number): number {
  return step >= 0 ? step + 1 : 1 / (1 - step);
}

/** All pairs with their values, as the server is asked. */
export function asked(criteria: readonly string[], judgements: Judgements): Record<string, number> {
  return Object.fromEntries(pairsOf(criteria).map((pair) => [pair.name, judged(judgements, pair)]));
}

/** Whether two sets say the same of each pair. */
export function same(criteria: readonly string[], one: Judgements, other: Judgements): boolean {
  return pairsOf(criteria).every((pair) => Math.abs(judged(one, pair) - judged(other, pair)) < 1e-9);
}
