import type { BlockEdit, Edited } from './reading';

/** The one change that makes a text another one: what both have at their beginning and end stays. */
export interface Edit {
  from: number;
  to: number;
  insert: string;
}

export function editBetween(before: string, after: string): Edit | null {
  if (before === after) return null;
  const most = Math.min(before.length, after.length);
  let head = 0;
  while (head < most && before[head] === after[head]) head += 1;
  let tail = 0;
  while (tail < most - head && before[before.length - 1 - tail] === after[after.length - 1 - tail]) tail += 1;
  return { from: head, to: before.length - tail, insert: after.slice(head, after.length - tail) };
}

/** An edit of the blocks, and the step that is looked at after it. */
export interface WantedEdit {
  edit: BlockEdit;
  path: string;
}

/**
 * Make an edit once those before it are made; whether it was made. `wanted` is asked for it then, and again where the
 * text was edited while it was made; null: it can be made no more. `know` is told before the text is another one.
 */
export type EditOfBlocks = (
  wanted: () => Promise<WantedEdit | null>,
  know: (made: Edited, wanted: WantedEdit) => void,
) => Promise<boolean>;
