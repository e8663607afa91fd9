/** The map of a feed, kept as the console has it. */
import type { FeedChange, Json } from './protocol';

/** Bring `entries` to where the console's map is. Whole ones begin anew; what is gone is told before what is set. */
export function applyChange(entries: Map<string, Json>, change: FeedChange): void {
  if (change.whole) entries.clear();
  for (const key of change.gone ?? []) entries.delete(key);
  for (const key in change.set) entries.set(key, change.set[key] as Json);
  for (const key in change.part) entries.set(key, { ...(entries.get(key) as object), ...change.part[key] });
}
