/** Who is logged in where, and what they may do. */
import { live } from './live.svelte';
import type { Fleet, Fleets, Link, Login, Me, Role } from './protocol';
import { csrfToken, getFleets, getMe, onLoggedOut, postLogin, postLogout, setCsrf, setUserAt } from './requests';

const RANKS: Record<Role, number> = { observer: 0, operator: 1, engineer: 2 };

/** Whether a login with these roles may do what `needed` may. */
export function covers(roles: readonly Role[], needed: Role): boolean {
  return roles.some((role) => (RANKS[role] ?? -1) >= RANKS[needed]);
}

/** Whether one and the same fleet has another user now. */
const isOther = (before: Partial<Login> | undefined, now: Partial<Login> | undefined) =>
  Boolean(before?.user && now?.user && before.user !== now.user);

const over: ((fleet: string | null) => void)[] = [];

/** Have something done when the login at a fleet is over; null: all of them are. */
export function onLoginOver(act: (fleet: string | null) => void): void {
  over.push(act);
}

const replaced: ((fleet: string, user: string) => void)[] = [];

/** Have something said when another person has logged in at a fleet in another tab of this browser. */
export function onReplaced(act: (fleet: string, user: string) => void): void {
  replaced.push(act);
}

class Session {
  /** Whether the console was asked already. */
  state = $state<'asking' | 'out' | 'in' | 'no-console'>('asking');
  known = $state.raw<Fleets>({ fleets: [], version: '' });
  logins = $state.raw<Record<string, Login>>({});
  /** A fleet whose login is asked for beside those that there are; empty: none. */
  wanted = $state('');
  /** Whether nobody is logged in any more without having asked for it. */
  ended = $state(false);
  /** Counts the persons: what one of them has begun is not gone on with by the next. */
  person = $state(0);

  constructor() {
    onLoggedOut(() => void this.#check());
    setUserAt((fleet) => this.logins[fleet]?.user ?? '');
  }

  /** A request was refused for want of a login: of all fleets, or of one whose session has ended. */
  async #check(): Promise<void> {
    const me = await getMe().catch(() => undefined);
    if (me === null) this.#end();
    else if (me) this.#enter(me);
  }

  async begin(): Promise<void> {
    try {
      this.known = await getFleets();
      this.#enter(await getMe());
    } catch {
      this.state = 'no-console';
    }
  }

  async login(fleet: string, user: string, password: string): Promise<void> {
    this.#enter(await postLogin(fleet, user, password), true);
    this.wanted = '';
  }

  /** Log out of one fleet, or of all. */
  async logout(fleet?: string): Promise<void> {
    await postLogout(fleet);
    this.#enter(fleet ? await getMe() : null);
  }

  fleet(name: string): Fleet | undefined {
    return this.known.fleets.find((one) => one.name === name);
  }

  /** Whether this person may do an operation, as `robots.hold`. */
  may(fleet: string, operation: string): boolean {
    return this.#now(fleet)?.may?.includes(operation) ?? false;
  }

  /** Whether this person has a role, or one above it. */
  is(fleet: string, role: Role): boolean {
    return covers(this.#now(fleet)?.roles ?? [], role);
  }

  /** A role may be given or taken away while somebody is logged in: the link says so. */
  #now(fleet: string): Partial<Login> | undefined {
    const link = live.links[fleet];
    return link?.roles ? link : this.logins[fleet];
  }

  #enter(me: Me | null, isOwn = false): void {
    const before = this.logins;
    this.logins = me?.fleets ?? {};
    const gone = Object.keys(before).filter((fleet) => !(fleet in this.logins));
    const others = Object.keys(this.logins).filter(
      (fleet) => before[fleet] && isOther(before[fleet], this.logins[fleet]),
    );
    const isOut = !me || Object.keys(this.logins).length === 0;
    for (const fleet of isOut ? [null] : [...gone, ...others]) for (const act of over) act(fleet);
    if (isOut || others.length) live.stop();
    if (isOut) {
      this.state = 'out';
      setCsrf('');
      return;
    }
    this.ended = false;
    setCsrf(me.csrf);
    this.state = 'in';
    if (others.length) this.person += 1;
    live.start({
      loggedOut: () => this.#end(),
      found: (found) => this.#enter(found),
      isAnother: (links) => this.#isAnother(links),
    });
    if (isOwn) return;
    for (const fleet of others) for (const act of replaced) act(fleet, this.logins[fleet]?.user ?? '');
  }

  /** Take over who another tab has logged in. */
  #isAnother(links: Record<string, Link>): boolean {
    const others = Object.entries(links).filter(([fleet, link]) => isOther(this.logins[fleet], link));
    if (!others.length) return false;
    const fleets = { ...this.logins, ...(Object.fromEntries(others) as Record<string, Link & Login>) };
    this.#enter({ fleets, csrf: csrfToken() });
    return true;
  }

  #end(): void {
    if (this.state !== 'in') return;
    this.ended = true;
    this.#enter(null);
  }
}

export const session = new Session();
