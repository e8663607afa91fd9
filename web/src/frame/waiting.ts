/** How much waits for a person, and on which pages. */
import { t } from '../lib/texts';

/** Keys of the feed `counts`, and the pages on which it is dealt with. */
export const PAGES_OF = { alarms: 'alarms', decisions: 'resilience' } as const;

export type Kind = keyof typeof PAGES_OF;

export interface Waiting {
  kind: Kind;
  page: string;
  n: number;
  /** In words, with whether that is of now. */
  text: string;
}

/** What waits, of what was told; nothing of what nothing waits for. */
export function waitingOf(counts: ReadonlyMap<string, unknown>, current: boolean): Waiting[] {
  return (Object.keys(PAGES_OF) as Kind[]).flatMap((kind) => {
    const n = counts.get(kind);
    if (typeof n !== 'number' || n < 1) return [];
    const text = t(`frame.wait_${kind}`, { n });
    return [{ kind, page: PAGES_OF[kind], n, text: current ? text : `${text} ${t('value.old')}` }];
  });
}

/** The title of the window: how much waits stands first, since little of a title is seen among many tabs. */
export function titleOf(title: string, waiting: readonly Waiting[], current: boolean): string {
  const all = current ? waiting.reduce((sum, one) => sum + one.n, 0) : 0;
  return all ? `(${all}) ${title}` : title;
}

/** What is said aloud: only what has become more, so that nobody hears the same twice. */
export function newsOf(before: ReadonlyMap<Kind, number>, waiting: readonly Waiting[]): string {
  return waiting
    .filter((one) => one.n > (before.get(one.kind) ?? 0))
    .map((one) => one.text)
    .join(' · ');
}
