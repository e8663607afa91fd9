/**
 * The course of numbers, for lines: what each was from when on, with gaps. It begins with what the server has kept, and
 * goes on with what this page has seen. Times are the browser's, in ms.
 */
export const KEPT_MS = 15 * 60_000;
/** Points of one number; with more the oldest half goes. */
const MOST = 12_000;

export class History {
  readonly times: number[] = [];
  readonly values: (number | null)[] = [];

  /** From `at` on it is `value`; null: a gap begins. */
  add(at: number, value: number | null): void {
    const last = this.values.length - 1;
    if (last >= 0 ? this.values[last] === value : value === null) return;
    this.times.push(at);
    this.values.push(value);
    if (this.times.length > MOST) this.#drop(MOST / 2);
    else if ((this.times[1] ?? at) < at - 2 * KEPT_MS) this.forget(at - KEPT_MS);
  }

  /** Forget what was over before `from`; what held then is kept. */
  forget(from: number): void {
    let first = 0;
    while (first + 1 < this.times.length && (this.times[first + 1] ?? 0) <= from) first += 1;
    this.#drop(first);
  }

  /** Put what the server has kept in the place of all between two times: at `until` this page has begun to see it. */
  fill(from: number, until: number, times: readonly number[], values: readonly (number | null)[]): void {
    const seen = new History();
    const put = (at: number, value: number | null) => {
      // Of two values of one moment the later one counts.
      if (seen.times.at(-1) === at) seen.#drop(-1);
      seen.add(at, value);
    };
    this.times.forEach((at, index) => at < from && put(at, this.values[index] ?? null));
    times.forEach((at, index) => at < until && put(Math.max(at, from), values[index] ?? null));
    const later = this.times.findIndex((at) => at >= until);
    // It was not Good when this page began to look, whatever was kept last.
    if (later < 0) put(until, null);
    else {
      // As it was seen, even where the last one that was kept is the same: this is where it was seen first.
      seen.times.push(...this.times.slice(later));
      seen.values.push(...this.values.slice(later));
    }
    this.times.splice(0, this.times.length, ...seen.times);
    this.values.splice(0, this.values.length, ...seen.values);
  }

  /** As it is now, whatever comes later. */
  copy(): History {
    const copy = new History();
    copy.times.push(...this.times);
    copy.values.push(...this.values);
    return copy;
  }

  /** The first ones; negative: the last ones. */
  #drop(count: number): void {
    const [at, some] = count < 0 ? [this.times.length + count, -count] : [0, count];
    this.times.splice(at, some);
    this.values.splice(at, some);
  }

  /** What it was at `count` times that end at `now`, the span apart in equal steps; null where nothing is known. */
  sampled(now: number, span_ms: number, count: number): (number | null)[] {
    const samples: (number | null)[] = [];
    let at = -1;
    for (let index = 1; index <= count; index++) {
      const time = now - span_ms + (span_ms * index) / count;
      while (at + 1 < this.times.length && (this.times[at + 1] ?? 0) <= time) at += 1;
      samples.push(at < 0 ? null : (this.values[at] ?? null));
    }
    return samples;
  }
}

/** The histories of one robot's numbers. */
export class Histories {
  readonly of = new Map<string, History>();
  #heard = new Map<string, unknown>();

  /** Take what a feed has now; an entry that is the same object as before is no news. */
  take(at: number, values: Iterable<[string, unknown, () => number | null]>): void {
    for (const [node, entry, number] of values) {
      if (this.#heard.get(node) === entry) continue;
      this.#heard.set(node, entry);
      this.history(node).add(at, number());
    }
  }

  /** That of a number; empty where nothing was seen of it. */
  history(node: string): History {
    let history = this.of.get(node);
    if (!history) this.of.set(node, (history = new History()));
    return history;
  }

  /** Nothing is known from now on, until values come again. */
  lose(at: number): void {
    for (const history of this.of.values()) history.add(at, null);
    this.#heard.clear();
  }
}
