/**
 * The dead man's switch of the page: what is wished now, and when to let go for good. Pure; time is an argument, in ms.
 *
 * A wish lasts as long as a key, the pad or a stick is held. `check` says why the robot is to be released, whatever is
 * held: nothing was heard of it for `deadman_ms`, this page stood for as long, or a gamepad that drove is gone. The
 * bridge would stop the robot for all of these by itself; a page that knows it says so, and drives no more.
 */
import { type Deflection, isDriveKey, isEnabled, ofKeys, ofPad, ofStick, REST, type Sample, together } from './axes';

/** Why this page lets go. The last four are told to it by the browser. */
export type Ending = 'stale' | 'stood' | 'gamepad_lost' | 'blur' | 'hidden' | 'left' | 'frozen' | 'released' | 'over';

/** A key that has repeated itself, and does no more though no other was pressed: its release was lost. */
export const REPEAT_LOST_MS = 700;

export class DeadMan {
  #keys = new Set<string>();
  /** The key that repeats itself, and when it did. */
  #repeat: { code: string; at: number } | null = null;
  #pad: { x: number; y: number } | null = null;
  #stick: Sample | null = null;
  /** Whether the stick was seen at rest since the robot is held: what is held down before drives nothing. */
  #armed = false;
  #has_driven = false;
  #heard_at: number;
  #checked_at: number;

  constructor(
    readonly deadman_ms: number,
    now: number,
  ) {
    this.#heard_at = this.#checked_at = now;
  }

  /** A key goes down, or repeats itself. One that was down before the robot was held drives nothing until it is pressed anew. */
  keyDown(code: string, repeats: boolean, now: number): void {
    if (!isDriveKey(code) || (repeats && !this.#keys.has(code))) return;
    this.#keys.add(code);
    this.#repeat = repeats ? { code, at: now } : null;
  }

  keyUp(code: string): void {
    this.#keys.delete(code);
    this.#repeat = null; // another key's repetition may end with it
  }

  /** Where the pad is held; null: nowhere. */
  pad(at: { x: number; y: number } | null): void {
    this.#pad = at;
  }

  /** What the gamepad shows now; null: there is none. */
  gamepad(sample: Sample | null): 'gamepad_lost' | null {
    const was_there = this.#stick !== null;
    this.#stick = sample;
    if (!sample) {
      this.#armed = false;
      return was_there && this.#has_driven ? 'gamepad_lost' : null;
    }
    if (!isEnabled(sample)) this.#armed = true;
    if (this.#armed && isEnabled(sample)) this.#has_driven = true;
    return null;
  }

  /** All is let go: a stop by key, or keys whose release may not come. */
  letGo(): void {
    this.#keys.clear();
    this.#repeat = null;
    this.#pad = null;
    this.#armed = false;
  }

  /** A newer counter has come. */
  heard(now: number): void {
    this.#heard_at = now;
  }

  /** How old the newest counter is. */
  age(now: number): number {
    return now - this.#heard_at;
  }

  /** Call it in each period. */
  check(now: number): 'stale' | 'stood' | null {
    const stood = now - this.#checked_at >= this.deadman_ms;
    this.#checked_at = now;
    if (this.#repeat && now - this.#repeat.at > REPEAT_LOST_MS) {
      this.#keys.delete(this.#repeat.code);
      this.#repeat = null;
    }
    if (stood) return 'stood';
    return this.age(now) >= this.deadman_ms ? 'stale' : null;
  }

  get held(): ReadonlySet<string> {
    return this.#keys;
  }

  get deflection(): Deflection {
    return together(ofKeys(this.#keys), ofPad(this.#pad), this.#armed ? ofStick(this.#stick) : REST);
  }
}
