/**
 * One lease over `api/drive`, and the hands that use it: keys, pad, gamepad, and all that the browser says of this
 * page's end. Whatever ends it, zero and a release go out at once; what the bridge makes of it does not depend on them.
 */
import type { ErrorBody } from '../../lib/protocol';
import { csrfToken, shownUser } from '../../lib/requests';
import { t } from '../../lib/texts';
import { type Axis, type Deflection, mappingOf, type Mapping, REST, type Sample, speedsOf } from './axes';
import { DeadMan, type Ending } from './deadman';
import { MOST_WAITING_BYTES, Pace, PERIOD_MS } from './pace';

/** How a robot is driven: its axes, and times in ms. */
export interface Teleoperation {
  axes: Axis[];
  deadman_ms: number;
  lease_ms: number;
  robot_timeout_ms: number;
  period_ms: number;
  stop_ms: number;
}

interface Held extends Teleoperation {
  robot: string;
  lease: number;
  counter: number;
  taken_from: string;
}

interface Told {
  counter: number;
  taken: number;
  answered: number;
  state: string;
  output: number[];
  drops: Record<string, number>;
  dropped: Record<string, number>;
}

interface FromDrive extends Partial<Told> {
  held?: Held;
  over?: ErrorBody;
}

/** Figures change so often that they are shown less often. */
const SHOW_MS = 200;
const OPENING_MS = 15_000;
const GOODBYE_MS = 2000;

/** What was lost on the way; one that a newer took the place of was not. */
function dropped(drops: Record<string, number>): number {
  return Object.entries(drops).reduce((sum, [cause, n]) => sum + (cause === 'setpoint_overtaken' ? 0 : n), 0);
}

export class Driver {
  state = $state<'none' | 'asking' | 'held' | 'ending'>('none');
  held = $state.raw<Held | null>(null);
  /** Why this page drives no more: its own reason, or in the words of the console. */
  ending = $state<Ending | null>(null);
  error = $state.raw<ErrorBody | null>(null);

  deflection = $state.raw<Deflection>({ ...REST });
  keys = $state.raw<ReadonlySet<string>>(new Set());
  wished = $state.raw<number[]>([]);
  output = $state.raw<number[]>([]);
  stopping = $state(false);
  age_ms = $state<number | null>(null);
  bridge_ms = $state<number | null>(null);
  server_ms = $state<number | null>(null);
  dropped = $state(0);
  /** Name of the gamepad that is there; empty: none. */
  gamepad = $state('');

  /** The part of each axis' speed that the ends of the controls stand for. */
  share = $state(0.5);
  mapping = $state<Mapping>({ ahead: -1, turn: -1, third: -1 });

  #ws: WebSocket | null = null;
  #man: DeadMan | null = null;
  #pace = new Pace();
  #counter = 0;
  #ticking: ReturnType<typeof setInterval> | undefined;
  #soon: ReturnType<typeof setTimeout> | undefined;
  #opening: ReturnType<typeof setTimeout> | undefined;
  #shown_at = 0;
  #listening = new AbortController();

  acquire(fleet: string, robot: string, takeOver: boolean): void {
    if (this.state !== 'none') return;
    this.state = 'asking';
    this.ending = null;
    this.error = null;
    const ws = new WebSocket(new URL('api/drive', document.baseURI).href.replace(/^http/, 'ws'));
    this.#ws = ws;
    this.#listen();
    this.#opening = setTimeout(() => this.#close('over', { message: t('drive.no_answer') }), OPENING_MS);
    ws.onopen = () =>
      ws.send(JSON.stringify({ csrf: csrfToken(), fleet, user: shownUser(fleet), robot, take_over: takeOver }));
    ws.onmessage = (event) => {
      if (ws === this.#ws) this.#take(JSON.parse(event.data as string) as FromDrive);
    };
    ws.onclose = (event) => {
      if (ws === this.#ws) this.#close('over', event.reason ? { message: event.reason } : null);
    };
  }

  /** Zero, and the robot is given back. */
  release(why: Ending = 'released'): void {
    if (this.state === 'asking') this.#close(why, null);
    if (this.state !== 'held') return;
    this.ending = why;
    this.state = 'ending';
    this.#man?.letGo();
    this.#send(this.#zero());
    this.#say({ release: true });
    this.#hands();
    this.#quiet();
    // The console answers when the server has; this page does not wait for long.
    this.#opening = setTimeout(() => this.#close(why, null), GOODBYE_MS);
  }

  keyDown(event: KeyboardEvent): void {
    const man = this.#man;
    if (!man || this.state !== 'held') return;
    // With these held down a browser may never tell of a key's release.
    if (event.metaKey || event.ctrlKey || event.altKey) {
      this.letGo();
      return;
    }
    man.keyDown(event.code, event.repeat, performance.now());
    this.#changed();
  }

  keyUp(event: KeyboardEvent): void {
    this.#man?.keyUp(event.code);
    this.#changed();
  }

  pad(at: { x: number; y: number } | null): void {
    this.#man?.pad(at);
    this.#changed();
  }

  /** All is let go, and the robot is kept: it is brought to a standstill. */
  letGo(): void {
    this.#man?.letGo();
    this.#changed();
  }

  // ---------------------------------------------------------------- what the console says

  #take(message: FromDrive): void {
    const now = performance.now();
    if (message.held) this.#begin(message.held, now);
    else if (message.over) this.#close(this.ending ?? 'over', message.over);
    else this.#hear(message as Told, now);
  }

  #begin(held: Held, now: number): void {
    clearTimeout(this.#opening);
    this.held = held;
    this.mapping = mappingOf(held.axes);
    this.#counter = held.counter;
    this.#man = new DeadMan(held.deadman_ms, now);
    this.#pace = new Pace();
    this.output = this.#zero();
    this.stopping = false;
    this.dropped = 0;
    this.bridge_ms = this.server_ms = this.age_ms = null;
    this.state = 'held';
    // Who has looked away meanwhile does not drive.
    if (document.hidden) this.release('hidden');
    else if (!document.hasFocus()) this.release('blur');
    else {
      this.#ticking = setInterval(() => this.#tick(), PERIOD_MS);
      this.#tick();
    }
  }

  #hear(told: Told, now: number): void {
    if (told.counter !== this.#counter) {
      this.#counter = told.counter;
      this.#man?.heard(now);
    }
    this.#pace.told(told.answered, told.taken, now);
    this.output = told.output;
    this.stopping = told.state === 'Stopping';
    this.dropped = dropped(told.drops) + dropped(told.dropped);
  }

  // ---------------------------------------------------------------- what goes out

  #tick(): void {
    const man = this.#man;
    if (!man || this.state !== 'held') return;
    const now = performance.now();
    const lost = man.gamepad(this.#gamepad());
    const why = lost ?? man.check(now);
    if (why) {
      this.release(why);
      return;
    }
    this.#changed();
    if (now - this.#shown_at >= SHOW_MS) {
      this.#shown_at = now;
      this.age_ms = man.age(now);
      this.bridge_ms = this.#pace.bridge_ms;
      this.server_ms = this.#pace.server_ms;
    }
  }

  /** Send what is wished, where it is due. */
  #changed(): void {
    this.#hands();
    if (this.state !== 'held' || !this.held) return;
    const values = speedsOf(this.deflection, this.held.axes, this.mapping, this.share);
    this.wished = values;
    clearTimeout(this.#soon);
    const wait = this.#pace.due(values, performance.now());
    if (wait <= 1) this.#send(values);
    else if (wait < PERIOD_MS) this.#soon = setTimeout(() => this.#changed(), wait);
  }

  #hands(): void {
    this.deflection = this.#man?.deflection ?? { ...REST };
    this.keys = new Set(this.#man?.held);
  }

  #send(values: readonly number[]): void {
    const ws = this.#ws;
    if (!ws || ws.bufferedAmount > MOST_WAITING_BYTES) return;
    this.#say({ n: this.#pace.send(values, performance.now()), echo: this.#counter, values });
  }

  #say(message: object): void {
    if (this.#ws?.readyState === WebSocket.OPEN) this.#ws.send(JSON.stringify(message));
  }

  #zero(): number[] {
    return (this.held?.axes ?? []).map(() => 0);
  }

  #gamepad(): Sample | null {
    const found = navigator.getGamepads().find((one) => one?.connected) ?? null;
    this.gamepad = found?.id ?? '';
    return (
      found && {
        axes: found.axes,
        pressed: found.buttons.map((one) => one.pressed),
        standard: found.mapping === 'standard',
      }
    );
  }

  // ---------------------------------------------------------------- its end

  /** Whatever takes the page from its operator. `freeze` and `pagehide` may be the last that it ever does. */
  #listen(): void {
    const { signal } = (this.#listening = new AbortController());
    addEventListener('blur', () => this.release('blur'), { signal });
    addEventListener('pagehide', () => this.release('left'), { signal });
    document.addEventListener('visibilitychange', () => document.hidden && this.release('hidden'), { signal });
    document.addEventListener('freeze', () => this.release('frozen'), { signal });
    document.addEventListener('resume', () => this.release('frozen'), { signal });
    addEventListener('gamepaddisconnected', () => this.#tick(), { signal });
  }

  #quiet(): void {
    clearInterval(this.#ticking);
    clearTimeout(this.#soon);
    clearTimeout(this.#opening);
    this.#listening.abort();
  }

  #close(why: Ending, error: ErrorBody | null): void {
    const ws = this.#ws;
    this.#ws = null;
    this.#quiet();
    this.#man = null;
    this.held = null;
    this.wished = [];
    this.keys = new Set();
    this.deflection = { ...REST };
    this.ending = why;
    this.error = why === 'over' ? (error ?? { message: t('drive.connection_lost') }) : null;
    this.state = 'none';
    ws?.close(1000);
  }
}
