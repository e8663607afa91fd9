/**
 * Live data: one WebSocket to the console, feeds as maps that Svelte follows.
 *
 * A component says `const robots = useFeed<Robot>(() => ({ fleet, feed: 'robots' }))` and reads `robots.entries`,
 * `robots.state`, `robots.current`. Feeds of the same name and parameters are one on the wire. What is not `current` is
 * kept and shown as what it was: greyed, with its age.
 */
import { backoffMs } from './backoff';
import { clock } from './clock.svelte';
import { applyChange } from './entries';
import type { ErrorBody, FeedChange, FromConsole, FromPage, Json, Link, Me, Want } from './protocol';
import { csrfToken, getMe } from './requests';
import { t } from './texts';

/** A console that says its time says something at least each 5 s; silence for longer is a link that is gone. */
const SILENCE_MS = 15_000;
/** A feed that nobody looks at is kept this long, for the page that is opened next. */
const LINGER_MS = 1000;
const OPENING_MS = 10_000;
/** How often at most the console is told that somebody is here. */
const ACTIVE_MS = 60_000;
/** The console closes so what is not logged in any more. */
const LOGGED_OUT = 4401;

/** How a feed stands: nothing came yet, as the server has it, as it was, or refused. */
export type FeedState = 'loading' | 'current' | 'old' | 'error';

/** What is to be done with what the console says of the login. */
export interface LoginHeard {
  /** The console knows this browser no more. */
  loggedOut: () => void;
  /** This is who is logged in, where the connection was lost meanwhile. */
  found: (me: Me) => void;
  /** Links as they are now; true: another person has logged in, and all begins anew. */
  isAnother: (links: Record<string, Link>) => boolean;
}

/** What is followed of one entry. */
class Followed {
  version = $state(0);
}

class Feed {
  readonly entries = new Map<string, Json>();
  version = $state(0);
  #followed = new Map<string, Followed>();
  /** Entries that somebody has read since the last message. */
  #read = new Set<string>();
  /** Whether the map is the console's of this connection. */
  whole = $state(false);
  /** Whether it has ever been whole. */
  known = $state(false);
  error = $state.raw<ErrorBody | null>(null);
  users = 0;

  constructor(
    readonly id: string,
    readonly want: Want,
  ) {}

  /** Have who asks follow one entry. Until the next message they follow all of them. */
  follow(key: string): void {
    const followed = this.#followed.get(key);
    if (followed) void followed.version;
    else {
      this.#read.add(key);
      void this.version;
    }
  }

  /** Take what has changed, and say so to those who follow it. */
  take(change: FeedChange): void {
    if (change.error !== undefined) this.error = change.error;
    applyChange(this.entries, change);
    if (change.whole) {
      this.whole = this.known = true;
      for (const one of this.#followed.values()) one.version += 1;
    } else {
      for (const key of change.gone ?? []) this.#tell(key);
      for (const key in change.set) this.#tell(key);
      for (const key in change.part) this.#tell(key);
    }
    // Not where it is read: what is made there is not followed.
    for (const key of this.#read) this.#followed.set(key, new Followed());
    this.#read.clear();
    this.version += 1;
  }

  #tell(key: string): void {
    const one = this.#followed.get(key);
    if (one) one.version += 1;
  }
}

/** The WebSocket, the links of the console to the servers, and what is wanted of them. */
class Live {
  /** The WebSocket to the console. */
  socket = $state<'closed' | 'connecting' | 'live' | 'away'>('closed');
  /** Since when it is so, ISO 8601. */
  since = $state<string | null>(null);
  links = $state.raw<Record<string, Link>>({});

  #feeds = new Map<string, Feed>();
  #byId = new Map<string, Feed>();
  #ws: WebSocket | null = null;
  #attempt = 0;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #silence: ReturnType<typeof setTimeout> | undefined;
  #next_id = 0;
  #seen: number | null = null;
  #heard: LoginHeard = { loggedOut: () => {}, found: () => {}, isAnother: () => false };
  #active_at = 0;

  constructor() {
    addEventListener('online', () => this.#hurry());
    document.addEventListener('visibilitychange', () => document.hidden || this.#hurry());
    for (const event of ['pointerdown', 'keydown']) addEventListener(event, () => this.#act(), { passive: true });
  }

  /** Connect, and stay connected until `stop`. */
  start(heard: LoginHeard): void {
    this.#heard = heard;
    if (this.socket === 'closed') this.#open();
  }

  stop(): void {
    clearTimeout(this.#timer);
    clearTimeout(this.#silence);
    const ws = this.#ws;
    this.#ws = null;
    this.#seen = null;
    ws?.close(1000);
    this.#become('closed');
    this.links = {};
    this.#feeds.clear();
    this.#byId.clear();
    this.#attempt = 0;
  }

  /** How the way to a fleet's server stands, of which the way to the console is the first part. */
  link(fleet: string): Link {
    if (this.socket === 'live') {
      return this.links[fleet] ?? { state: 'connecting', since: this.since, reason: '' };
    }
    if (this.socket === 'away') return { state: 'away', since: this.since, reason: t('link.console_away') };
    return { state: 'connecting', since: this.since, reason: '' };
  }

  isLive(fleet: string): boolean {
    return this.link(fleet).state === 'live';
  }

  /** Why nobody acts on what is shown of a fleet, where a feed of it is not current. */
  whyOld(fleet: string): string {
    return this.isLive(fleet) ? t('link.old') : t('resilience.away');
  }

  /** The feed that is wanted; `leave` it when it is no more. */
  enter(want: Want): Feed {
    const key = JSON.stringify([want.fleet, want.feed, want.parameters]);
    let feed = this.#feeds.get(key);
    if (!feed) {
      feed = new Feed(`f${++this.#next_id}`, want);
      this.#feeds.set(key, feed);
      this.#byId.set(feed.id, feed);
      this.#send({ want: { [feed.id]: want } });
    }
    feed.users += 1;
    return feed;
  }

  leave(feed: Feed): void {
    feed.users -= 1;
    setTimeout(() => {
      if (feed.users > 0 || this.#byId.get(feed.id) !== feed) return;
      this.#byId.delete(feed.id);
      for (const [key, one] of this.#feeds) if (one === feed) this.#feeds.delete(key);
      this.#send({ drop: [feed.id] });
    }, LINGER_MS);
  }

  /** Somebody is here: their login does not end for want of anything that they do. */
  #act(): void {
    if (Date.now() - this.#active_at < ACTIVE_MS) return;
    this.#active_at = Date.now();
    this.#send({ active: true });
  }

  #become(socket: Live['socket']): void {
    if (this.socket === socket) return;
    this.socket = socket;
    this.since = new Date(clock.now).toISOString();
  }

  #open(): void {
    clearTimeout(this.#timer);
    if (this.socket !== 'away') this.#become('connecting');
    const ws = new WebSocket(new URL('api/live', document.baseURI).href.replace(/^http/, 'ws'));
    this.#ws = ws;
    this.#timer = setTimeout(() => this.#giveUp(ws), OPENING_MS);
    ws.onopen = () => {
      clearTimeout(this.#timer);
      this.#send({ csrf: csrfToken() });
      const want = Object.fromEntries([...this.#byId].map(([id, feed]) => [id, feed.want]));
      if (this.#byId.size) this.#send({ want });
    };
    ws.onmessage = (event) => {
      if (ws === this.#ws) this.#take(JSON.parse(event.data as string) as FromConsole);
    };
    ws.onclose = (event) => {
      if (ws !== this.#ws) return;
      if (event.code === LOGGED_OUT) this.#heard.loggedOut();
      else this.#lose();
    };
  }

  #take(message: FromConsole): void {
    if (message.links && this.#heard.isAnother(message.links)) return;
    this.#attempt = 0;
    this.#become('live');
    if (message.now) {
      clock.hear(message.now);
      clearTimeout(this.#silence);
      this.#silence = setTimeout(() => this.#giveUp(this.#ws), SILENCE_MS);
    }
    if (message.links) this.links = { ...this.links, ...message.links };
    for (const id in message.feeds) {
      const feed = this.#byId.get(id);
      const change = message.feeds[id];
      if (!feed || !change) continue; // dropped meanwhile
      feed.take(change);
    }
    for (const [fleet, link] of Object.entries(message.links ?? {})) {
      if (link.state !== 'live') this.#age(fleet, message.feeds ?? {});
    }
    this.#confirm(message.n);
  }

  /** What came before a link was lost is what was; what came with the news of it is newer. */
  #age(fleet: string, but: Record<string, unknown>): void {
    for (const feed of this.#byId.values()) if (feed.want.fleet === fleet && !(feed.id in but)) feed.whole = false;
  }

  /** After it is painted: so a slow page gets fewer messages, and each has the newest. */
  #confirm(n: number): void {
    const waiting = this.#seen !== null;
    this.#seen = n;
    if (waiting) return;
    const done = () => {
      if (this.#seen === null) return;
      const seen = this.#seen;
      this.#seen = null;
      clearTimeout(late);
      this.#send({ seen });
    };
    // A page that is not shown paints nothing, and its timers may run once a minute.
    const late = setTimeout(done, 100);
    if (document.hidden) done();
    else requestAnimationFrame(done);
  }

  #send(message: FromPage): void {
    if (this.#ws?.readyState === WebSocket.OPEN) this.#ws.send(JSON.stringify(message));
  }

  /** A peer that stands still answers no farewell either, for which a browser would wait. */
  #giveUp(ws: WebSocket | null): void {
    if (!ws || ws !== this.#ws) return;
    this.#lose();
    ws.close();
  }

  #lose(): void {
    clearTimeout(this.#timer);
    clearTimeout(this.#silence);
    this.#ws = null;
    this.#seen = null;
    for (const feed of this.#byId.values()) feed.whole = false;
    this.links = {};
    this.#attempt += 1;
    this.#become('away');
    this.#timer = setTimeout(() => void this.#again(), backoffMs(this.#attempt, Math.random()));
  }

  /** A refused WebSocket has no reason in a browser: a request says whether it is the login. */
  async #again(): Promise<void> {
    try {
      const me = await getMe();
      if (this.socket === 'closed' || this.#ws) return;
      if (!me) {
        this.#heard.loggedOut();
        return;
      }
      this.#heard.found(me);
      if (this.socket === 'away' && !this.#ws) this.#open();
    } catch {
      if (this.socket !== 'closed' && !this.#ws) this.#lose();
    }
  }

  /** The network is back, or somebody looks again: no reason to wait longer. */
  #hurry(): void {
    if (this.socket !== 'away' || this.#ws) return;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => void this.#again(), 100);
  }
}

export const live = new Live();

/** A feed as a component reads it. */
export class FeedView<T> {
  #feed = $state.raw<Feed | null>(null);
  #fleet: () => string | undefined;

  constructor(wanted: () => { fleet: string; feed: string; parameters?: object } | null) {
    this.#fleet = () => wanted()?.fleet;
    let entered = '';
    let feed: Feed | null = null;
    $effect(() => {
      const one = wanted();
      const want = one && { fleet: one.fleet, feed: one.feed, parameters: (one.parameters ?? {}) as Json };
      const key = JSON.stringify(want);
      if (key === entered) return;
      entered = key;
      const left = feed;
      feed = want ? live.enter(want) : null;
      if (left) live.leave(left);
      this.#feed = feed;
    });
    $effect(() => () => {
      if (feed) live.leave(feed);
      feed = null;
      entered = '';
    });
  }

  /** All entries by key, as they are now; the same Map each time, so derive from it what is shown. */
  get entries(): ReadonlyMap<string, T> {
    void this.#feed?.version;
    return (this.#feed?.entries ?? new Map()) as ReadonlyMap<string, T>;
  }

  /** One entry. */
  get(key: string): T | undefined {
    this.#feed?.follow(key);
    return this.#feed?.entries.get(key) as T | undefined;
  }

  /** Counts the messages, for what is not derived. */
  get version(): number {
    return this.#feed?.version ?? 0;
  }

  get state(): FeedState {
    const feed = this.#feed;
    if (!feed) return 'loading';
    if (feed.error) return feed.known ? 'old' : 'error';
    const fleet = this.#fleet();
    if (feed.whole && fleet !== undefined && live.isLive(fleet)) return 'current';
    return feed.known ? 'old' : 'loading';
  }

  /** Whether anything was ever told: before that, no entries are not none. */
  get known(): boolean {
    return this.#feed?.known ?? false;
  }

  /** Whether what is shown is of now. */
  get current(): boolean {
    return this.state === 'current';
  }

  get error(): ErrorBody | null {
    return this.#feed?.error ?? null;
  }
}

/** Follow a feed while this component is there; null: none. Call it while the component is made. */
export function useFeed<T>(wanted: () => { fleet: string; feed: string; parameters?: object } | null): FeedView<T> {
  return new FeedView<T>(wanted);
}
