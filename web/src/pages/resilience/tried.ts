/** What a person has tried of open decisions: it is theirs alone, and is kept in this window while they are logged in. */
import { onLoginOver, session } from '../../lib/session.svelte';
import type { Judgements } from './judgements';

const KEY = 'ua-fleet.tried';

interface Kept {
  fleet: string;
  user: string;
  decision: string;
  judgements: Judgements;
}

/** The storage of this window, which outlives a reload; a browser may refuse it. */
function read(): Kept[] {
  try {
    return JSON.parse(sessionStorage.getItem(KEY) ?? '[]') as Kept[];
  } catch {
    return [];
  }
}

function write(kept: readonly Kept[]): void {
  try {
    if (kept.length) sessionStorage.setItem(KEY, JSON.stringify(kept));
    else sessionStorage.removeItem(KEY);
  } catch {
    // Then it is lost with the view, as what is not said to be kept.
  }
}

const userAt = (fleet: string) => session.logins[fleet]?.user ?? '';
const isOne = (fleet: string, decision: string) => (one: Kept) =>
  one.fleet === fleet && one.decision === decision && one.user === userAt(fleet);

/** What this person has tried of a decision; null: nothing. */
export function triedOf(fleet: string, decision: string): Judgements | null {
  return read().find(isOne(fleet, decision))?.judgements ?? null;
}

/** Keep it; null: no longer. */
export function keepTried(fleet: string, decision: string, judgements: Judgements | null): void {
  const others = read().filter((one) => !isOne(fleet, decision)(one));
  write(judgements ? [...others, { fleet, user: userAt(fleet), decision, judgements }] : others);
}

onLoginOver((fleet) => write(fleet === null ? [] : read().filter((one) => one.fleet !== fleet)));
