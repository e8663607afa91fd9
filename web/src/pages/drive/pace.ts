/** When setpoints are sent, and how long they take there and back. Pure; time is an argument, in ms. */

export const PERIOD_MS = 40;
/** A wish that changes is sent at once, but not sooner than this after the last. */
export const SOONEST_MS = 12;
/** What waits in the browser is old when it arrives: nothing is added to it. */
export const MOST_WAITING_BYTES = 2048;

export class Pace {
  #number = 0;
  #sent_at = -Infinity;
  #last: readonly number[] = [];
  #on_the_way = new Map<number, number>();
  /** The last setpoint that came back: to the bridge, and to the server alone. */
  bridge_ms: number | null = null;
  server_ms: number | null = null;
  #answered = 0;
  #taken = 0;

  /** In how many ms to send these; 0: now. */
  due(values: readonly number[], now: number): number {
    const changed = values.length !== this.#last.length || values.some((value, place) => value !== this.#last[place]);
    return Math.max(0, this.#sent_at + (changed ? SOONEST_MS : PERIOD_MS) - now);
  }

  /** They are sent now, under this number. */
  send(values: readonly number[], now: number): number {
    this.#sent_at = now;
    this.#last = values;
    this.#on_the_way.set(++this.#number, now);
    return this.#number;
  }

  /** The console tells the newest that the server has sent on, and that the bridge has taken. */
  told(answered: number, taken: number, now: number): void {
    if (answered > this.#answered) {
      this.#answered = answered;
      this.server_ms = this.#since(answered, now) ?? this.server_ms;
    }
    if (taken > this.#taken) {
      this.#taken = taken;
      this.bridge_ms = this.#since(taken, now) ?? this.bridge_ms;
      for (const number of this.#on_the_way.keys()) {
        if (number > taken) break;
        this.#on_the_way.delete(number);
      }
    }
  }

  #since(number: number, now: number): number | null {
    const at = this.#on_the_way.get(number);
    return at === undefined ? null : now - at;
  }
}
