/** How long to wait before the next attempt: twice as long each time up to 10 s, any part of it by chance. */
const FIRST_MS = 500;
const MOST_MS = 10_000;

/**
 * @param attempt how many have failed, from 1
 * @param chance of [0, 1): many pages that lost the same console come back at different times
 */
export function backoffMs(attempt: number, chance: number): number {
  const most = Math.min(MOST_MS, FIRST_MS * 2 ** (attempt - 1));
  return Math.round(most * (0.25 + 0.75 * chance));
}
