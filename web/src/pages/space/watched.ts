import type { Shown } from '../../lib/protocol';
import { t } from '../../lib/texts';
import { statusName } from '../../lib/value';

/** The NodeIds that are watched, as the address of the page keeps them. */
export const MOST_WATCHED = 50;

export function parseWatched(text: string): string[] {
  if (!text) return [];
  try {
    const parsed: unknown = JSON.parse(text);
    if (!Array.isArray(parsed)) return [];
    return [...new Set(parsed.filter((one): one is string => typeof one === 'string' && one !== ''))].slice(
      0,
      MOST_WATCHED,
    );
  } catch {
    return []; // typed by hand
  }
}

export function formatWatched(nodes: readonly string[]): string {
  return nodes.length ? JSON.stringify(nodes) : '';
}

/** The StatusCode of a value; one that is not of now is said to be that of before. */
export function statusText(value: Shown | undefined, current: boolean): string {
  if (!value) return '—';
  return current ? statusName(value.s) : t('states.was', { state: statusName(value.s) });
}
