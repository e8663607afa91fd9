/** Robots as lists of them follow a feed: of a thousand that are told each second, most are what they were. */
import type { Robot } from './robots';

/** What of a robot is another one at each message. Who shows it asks the feed, so that nothing else is looked at again. */
const OFTEN: ReadonlySet<string> = new Set<keyof Robot>(['updated', 'marked']);

export class Roster {
  #known = new Map<string, { told: Robot; kept: Robot }>();
  #told: Robot[] = [];
  #all: readonly Robot[] = [];

  /** All robots of a feed. The same array as before, and the same robots in it, where only what changes often has. */
  of(entries: ReadonlyMap<string, Robot>): readonly Robot[] {
    const before = this.#all;
    let all: Robot[] | null = entries.size === before.length ? null : [];
    let at = 0;
    for (const one of entries.values()) {
      const known = before[at];
      // Most are not in a message, and stand where they stood.
      const kept = known && one === this.#told[at] ? known : this.#kept(one);
      this.#told[at] = one;
      if (!all && kept !== known) all = before.slice(0, at);
      all?.push(kept);
      at += 1;
    }
    if (!all) return before;
    this.#told.length = at;
    if (this.#known.size > at) {
      for (const name of this.#known.keys()) if (!entries.has(name)) this.#known.delete(name);
    }
    return (this.#all = all);
  }

  #kept(told: Robot): Robot {
    const one = this.#known.get(told.name);
    if (!one) this.#known.set(told.name, { told, kept: told });
    else if (one.told !== told) {
      one.told = told;
      if (!isAlike(one.kept, told)) one.kept = told;
    }
    return one?.kept ?? told;
  }
}

/** Whether two states of a robot differ at most in what changes often; that a value is marked does not. */
function isAlike(a: Robot, b: Robot): boolean {
  return a.marked?.length === b.marked?.length && isEqual(a, b, OFTEN);
}

function isEqual(a: unknown, b: unknown, but?: ReadonlySet<string>): boolean {
  if (a === b) return true;
  if (typeof a !== 'object' || typeof b !== 'object' || a === null || b === null) return false;
  const [one, other] = [a as Record<string, unknown>, b as Record<string, unknown>];
  const keys = Object.keys(one);
  if (keys.length !== Object.keys(other).length) return false;
  for (const key of keys)
    if (!but?.has(key) && !(Object.hasOwn(other, key) && isEqual(one[key], other[key]))) return false;
  return true;
}
