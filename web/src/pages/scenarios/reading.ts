/** What is read of a scenario's text beside its editor: a long one takes longer than a key may, so a worker does it. */
import type { Answer } from '../../lib/worker';
import { type Block, type Blocks, blocksOf, type List } from './document';
import { type Fields, fieldsOf } from './fields';

/** What can be asked of the reader, by name. */
export const READING = { blocksOf, fieldsOf } as const;

export type Reading = typeof READING;
export type ReadName = keyof Reading;

export interface Question<Name extends ReadName = ReadName> {
  id: number;
  name: Name;
  given: Parameters<Reading[Name]>;
}

type Found = Blocks | Fields | null;

/** The answer to a question; what is thrown is an answer too. */
export function answered({ id, name, given }: Question): Answer<Found> {
  try {
    return { id, found: (READING[name] as (...all: string[]) => Found)(...given) };
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
