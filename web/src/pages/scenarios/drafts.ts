/** Texts that were changed and not stored, kept while the page is there: who looks at a run meanwhile loses nothing. */
export interface Draft {
  text: string;
  /** What was read of the folder, and its version; empty ones are of a scenario that is new. */
  stored: string;
  version: string;
}

const drafts = new Map<string, Draft>();
const keyOf = (fleet: string, name: string) => JSON.stringify([fleet, name]);

export const draftOf = (fleet: string, name: string) => drafts.get(keyOf(fleet, name));

export function keepDraft(fleet: string, name: string, draft: Draft): void {
  if (draft.text === draft.stored) drafts.delete(keyOf(fleet, name));
  else drafts.set(keyOf(fleet, name), draft);
}

export function dropDraft(fleet: string, name: string): void {
  drafts.delete(keyOf(fleet, name));
}

addEventListener('beforeunload', (event) => {
  if (drafts.size) event.preventDefault();
});
