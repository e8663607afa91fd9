/** The past of a robot's numbers: what the server has kept of them is asked for once for each span and connection. */
import type { Histories } from './history';

/** How far back a line goes, in how many points. */
export interface Span {
  span_ms: number;
  points: number;
}

/** Of the short lines of all numbers, and of the chosen ones in the chart. */
export const SHORT: Span = { span_ms: 60_000, points: 60 };
export const LONG: Span = { span_ms: 600_000, points: 300 };

/** Numbers whose past is asked for at once. */
export const MOST_PAST = 250;

/** What `node.trends` answers. */
export interface Trends {
  now: string;
  lines: Record<string, { back: number[]; values: (number | null)[]; average: boolean }>;
}

export type AskTrends = (nodes: readonly string[], span: Span) => Promise<Trends>;

export class Past {
  /** When this page began to see values without a break; null: it does not. */
  #begun: number | null = null;
  /** How far back each number is known or asked for, since then. */
  #known = new Map<string, number>();

  constructor(
    readonly histories: Histories,
    readonly ask: AskTrends,
  ) {}

  /** Values come from now on. */
  begin(now: number): void {
    if (this.#begun !== null) return;
    this.#begun = now;
    this.#known.clear();
  }

  /** Nothing comes any more: what is missed until it does is asked for then. */
  lose(): void {
    this.#begun = null;
  }

  /** Have the past of some numbers, where it is not there; what cannot be had is left as it is. */
  async want(nodes: readonly string[], span: Span, now: () => number): Promise<void> {
    const begun = this.#begun;
    const missing = nodes.filter((node) => (this.#known.get(node) ?? 0) < span.span_ms);
    if (begun === null || missing.length === 0) return;
    for (const node of missing) this.#known.set(node, span.span_ms);
    let told: Trends;
    try {
      told = await this.ask(missing, span);
    } catch {
      return; // the line begins here, as without a history
    }
    if (this.#begun !== begun) return; // it was lost meanwhile, and is asked for anew
    const at = now();
    for (const [node, { back, values }] of Object.entries(told.lines)) {
      if (back.length === 0) continue;
      const times = back.map((ms) => at - ms);
      this.histories.history(node).fill(at - span.span_ms, begun, times, values);
    }
  }
}
