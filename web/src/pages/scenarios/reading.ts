/**
 * What is read of a scenario's text beside its editor, and edits of its blocks, which read it several times: a long one
 * takes longer than a key may, so a worker does it.
 */
import type { Answer } from '../../lib/worker';
import { type Block, type Blocks, blocksOf, type List } from './document';
import { type Change, changed, type Fields, fieldsOf } from './fields';
import { inserted, moved, removed } from './moves';

export type BlockEdit =
  | { kind: 'move'; path: string; list: string; at: number }
  | { kind: 'insert'; list: string; at: number; step: string }
  | { kind: 'remove'; path: string }
  | { kind: 'change'; path: string; changes: readonly Change[] };

/** A text that was edited, and what is read of it. */
export interface Edited {
  text: string;
  blocks: Blocks;
  /** Of the step at the path that was asked for. */
  fields: Fields | null;
}

function textOf(text: string, edit: BlockEdit): string | null {
  switch (edit.kind) {
    case 'move':
      return moved(text, edit.path, edit.list, edit.at);
    case 'insert':
      return inserted(text, edit.list, edit.at, edit.step);
    case 'remove':
      return removed(text, edit.path);
    case 'change':
      return changed(text, edit.path, edit.changes);
  }
}

/** A text with an edit, after which the step at `path` is looked at; null: the edit cannot be made. */
export function edited(text: string, edit: BlockEdit, path: string): Edited | null {
  const now = textOf(text, edit);
  return now === null ? null : { text: now, blocks: blocksOf(now), fields: fieldsOf(now, path) };
}

/** What can be asked of the reader, by name. */
export const READING = { blocksOf, fieldsOf, edited } as const;

export type Reading = typeof READING;
export type ReadName = keyof Reading;

export interface Question<Name extends ReadName = ReadName> {
  id: number;
  name: Name;
  given: Parameters<Reading[Name]>;
}

type Found = ReturnType<Reading[ReadName]>;

/** The answer to a question; what is thrown is an answer too. */
export function answered({ id, name, given }: Question): Answer<Found> {
  try {
    return { id, found: (READING[name] as (...all: readonly unknown[]) => Found)(...given) };
  } catch (error) {
    return { id, failed: String(error) };
  }
}

/** The same list, with the objects of before for all that is as it was: so it is not looked at again. */
export function keptList(before: List | null, now: List): List {
  if (!before || before.path !== now.path) return now;
  const blocks = now.blocks.map((block, at) => keptBlock(before.blocks[at], block));
  const same =
    before.key === now.key &&
    before.open === now.open &&
    before.blocks.length === blocks.length &&
    blocks.every((block, at) => block === before.blocks[at]);
  return same ? before : { ...now, blocks };
}

function keptBlock(before: Block | undefined, now: Block): Block {
  if (!before || before.path !== now.path) return now;
  const lists = now.lists.map((list, at) => keptList(before.lists[at] ?? null, list));
  const same =
    (['kind', 'title', 'detail', 'line', 'fixed'] as const).every((name) => before[name] === now[name]) &&
    before.lists.length === lists.length &&
    lists.every((list, at) => list === before.lists[at]);
  return same ? before : { ...now, lists };
}
