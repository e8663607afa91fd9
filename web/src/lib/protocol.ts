/** What the console and this page say to each other. */

/** A value as an OPC UA server tells it: `v` the value, `s` its StatusCode, `t` its SourceTimestamp, `u` its unit. */
export interface Shown {
  v: Json;
  s: number;
  t: string | null;
  u?: string;
}

export type Json = null | boolean | number | string | Json[] | { [key: string]: Json };

export interface Problem {
  line?: number;
  column?: number;
  message: string;
}

/** An error as the console tells it: one line that says what, where, what to do. */
export interface ErrorBody {
  message: string;
  status?: string;
  code?: number;
  field?: string;
  problems?: Problem[];
}

export interface Fleet {
  name: string;
  title: string;
  endpoint: string;
}

export interface Fleets {
  fleets: Fleet[];
  version: string;
  banner?: string;
}

export type Role = 'observer' | 'operator' | 'engineer';

export interface Login {
  user: string;
  roles: Role[];
  /** Operations that they may do, as the server says; it refuses the others all the same. */
  may?: string[];
}

export interface Me {
  fleets: Record<string, Login>;
  csrf: string;
}

export type LinkState = 'live' | 'connecting' | 'away' | 'ended';

/** How one OPC UA session of this person stands, and what they may do there now. */
export interface Link extends Partial<Login> {
  state: LinkState;
  since: string | null;
  reason: string;
  /** How far the server's clock is ahead of the console's. */
  ahead_s?: number;
}

export interface Want {
  fleet: string;
  feed: string;
  parameters: Json;
}

/** What the page sends over `api/live`. */
export interface FromPage {
  csrf?: string;
  want?: Record<string, Want>;
  drop?: string[];
  seen?: number;
  /** A person did something: their login is not idle. */
  active?: boolean;
}

export interface FeedChange {
  /** The map begins anew with this message. */
  whole?: boolean;
  set?: Record<string, Json>;
  /** Of entries that are objects: what is another one than before, while the rest of each is the same. */
  part?: Record<string, { [name: string]: Json }>;
  gone?: string[];
  /** What is wrong with it, while the console tries again; null: over. */
  error?: ErrorBody | null;
}

/** What the console sends over `api/live`. */
export interface FromConsole {
  n: number;
  feeds?: Record<string, FeedChange>;
  links?: Record<string, Link>;
  /** The console's time: a browser's clock may be wrong. */
  now?: string;
}
