/** The console's time, to the second: ages are told by it, since a browser's clock may be wrong. */
class Clock {
  /** Milliseconds since 1970, renewed once a second. */
  now = $state(Date.now());
  /** A time of the same day, renewed with the day: for what tells days apart, and would be the same each second. */
  today = $state(Date.now());
  #offset_ms = 0;

  constructor() {
    setInterval(() => this.#renew(), 1000);
  }

  /** The console said its time just now. What took long on its way says less, so small differences change nothing. */
  hear(time: string): void {
    const offset = Date.parse(time) - Date.now();
    if (Number.isNaN(offset) || Math.abs(offset - this.#offset_ms) < 500) return;
    this.#offset_ms = Math.abs(offset) < 500 ? 0 : offset;
    this.#renew();
  }

  #renew(): void {
    this.now = Date.now() + this.#offset_ms;
    if (new Date(this.now).toDateString() !== new Date(this.today).toDateString()) this.today = this.now;
  }
}

export const clock = new Clock();
