/**
 * Steps put in, moved and taken away, as small changes of a text: the lines of a step, or its part of a pair of
 * brackets. All else stays to the sign; comments right above a step, and at the end of its lines, go with it.
 *
 * An edit that would say something else than what is wanted, or lose a comment, is none: its answer is null.
 */
import { isMap, isPair, isScalar, isSeq, parseDocument, visit } from 'yaml';
import {
  indentOf,
  Lines,
  type List,
  nodeAt,
  parsed,
  type Part,
  partsOf,
  rangeOf,
  spacesOf,
  trimmedEnd,
} from './document';
import type { Edit } from './edits';
import { ifKeepsComments, ifSays, listOf, meaningOf, type Plain, valueAt } from './meaning';
import type { BlockEdit } from './reading';

/** Where the steps of a list stand. */
type Spot =
  | { kind: 'lines'; parts: Part[] }
  | { kind: 'brackets'; items: [number, number][]; between: string; inside: number }
  /** A key without a value: where the first step's line goes, and how far it is indented. */
  | { kind: 'nothing'; place: number; indent: number };

/** A step as it can be put into lines, and into brackets (null: it cannot). */
interface Source {
  lines: string;
  indent: number;
  inner: () => string | null;
}

/** Lines moved to another indentation. */
function indented(lines: string, by: number): string {
  if (by === 0) return lines;
  return lines
    .split('\n')
    .map((line) =>
      line.trim() === '' ? line : by > 0 ? ' '.repeat(by) + line : line.slice(Math.min(-by, indentOf(line))),
    )
    .join('\n');
}

const parentOf = (path: string) => path.slice(0, path.lastIndexOf('/'));
const numberOf = (path: string) => Number(path.slice(path.lastIndexOf('/') + 1));
const withEnd = (lines: string) => (lines.endsWith('\n') ? lines : `${lines}\n`);
const spaces = (count: number) => ' '.repeat(count);

export function applied(text: string, edits: readonly Edit[]): string {
  return [...edits]
    .sort((a, b) => b.from - a.from)
    .reduce((now, edit) => now.slice(0, edit.from) + edit.insert + now.slice(edit.to), text);
}

function spotOf(text: string, path: string): Spot | null {
  const node = nodeAt(text, path);
  const [from = 0] = rangeOf(node) ?? [];
  if (isSeq(node) && node.flow) {
    const between = spacesOf(text, node);
    if (between.some((one) => one.includes('#'))) return null;
    const items = node.items.map((item) => rangeOf(item)?.slice(0, 2) as [number, number]);
    return { kind: 'brackets', items, between: between.length > 2 ? (between[1] ?? ', ') : ', ', inside: from + 1 };
  }
  if (isSeq(node)) {
    const parts = partsOf(text, node);
    return parts && { kind: 'lines', parts };
  }
  return isScalar(node) && node.value === null ? nothingAt(text, path) : null;
}

/** Below a key that has no value. */
function nothingAt(text: string, path: string): Spot | null {
  const cut = path.lastIndexOf('/');
  const around = cut < 0 ? parsed(text).contents : nodeAt(text, path.slice(0, cut));
  if (!isMap(around) || around.flow) return null;
  const pair = around.items.find((one) => isPair(one) && isScalar(one.key) && one.key.value === path.slice(cut + 1));
  const range = rangeOf(pair?.key);
  if (!range) return null;
  const lines = new Lines(text);
  return { kind: 'nothing', place: lines.after(range[1]), indent: range[0] - lines.startOf(range[0]) + 2 };
}

function countOf(spot: Spot): number {
  if (spot.kind === 'nothing') return 0;
  return (spot.kind === 'lines' ? spot.parts : spot.items).length;
}

function removal(text: string, spot: Spot, at: number): Edit | null {
  if (countOf(spot) < 2) return null; // a list keeps one
  if (spot.kind === 'lines') {
    const part = spot.parts[at];
    if (!part) return null;
    // What follows comes to where its dash was.
    const more = part.inline ? text.slice(part.to).search(/\S|$/) : 0;
    return { from: part.from, to: part.to + more, insert: '' };
  }
  if (spot.kind === 'nothing') return null;
  const [item, before, next] = [spot.items[at], spot.items[at - 1], spot.items[at + 1]];
  if (!item) return null;
  if (before) return { from: before[1], to: item[1], insert: '' };
  return next ? { from: item[0], to: next[0], insert: '' } : null;
}

function insertion(text: string, spot: Spot, at: number, step: Source): Edit | null {
  if (spot.kind === 'brackets') {
    const inner = step.inner();
    if (inner === null) return null;
    const [item, last] = [spot.items[at], spot.items.at(-1)];
    if (item) return { from: item[0], to: item[0], insert: inner + spot.between };
    const place = last?.[1] ?? spot.inside;
    return { from: place, to: place, insert: last ? spot.between + inner : inner };
  }
  const [indent, part] = spot.kind === 'lines' ? [spot.parts[0]?.indent ?? 0, spot.parts[at]] : [spot.indent, null];
  const lines = indented(withEnd(step.lines), indent - step.indent);
  if (part?.inline) return { from: part.from, to: part.from, insert: lines.trimStart() + spaces(indent) };
  const place = part?.from ?? (spot.kind === 'lines' ? (spot.parts.at(-1)?.to ?? text.length) : spot.place);
  const before = place > 0 && text[place - 1] !== '\n' ? '\n' : '';
  return { from: place, to: place, insert: before + lines };
}

/** A step within brackets, in one line; null where that loses a comment. */
function inBrackets(step: string): string | null {
  const document = parseDocument(step, { uniqueKeys: false });
  if (document.errors.length) return null;
  visit(document, { Collection: (_, node) => void (node.flow = true) });
  return document.toString({ lineWidth: 0, flowCollectionPadding: false }).trim();
}

/** A step that is given as YAML without indentation. */
function sourceOf(step: string): Source {
  return { lines: `- ${step.replaceAll('\n', '\n  ')}\n`, indent: 0, inner: () => inBrackets(step) };
}

/** A step of a text. */
function sourceAt(text: string, spot: Spot, path: string): Source | null {
  const at = numberOf(path);
  if (spot.kind === 'lines') {
    const part = spot.parts[at];
    if (!part) return null;
    const lines = (part.inline ? spaces(part.indent) : '') + text.slice(part.from, part.to);
    const inner = () => {
      const node = nodeAt(text, path);
      const range = rangeOf(node);
      if (!range) return null;
      if ((isMap(node) || isSeq(node)) && node.flow) return text.slice(range[0], range[1]);
      const own = text.slice(range[0], trimmedEnd(text, range[0], range[1]));
      return inBrackets(indented(own, -(range[0] - new Lines(text).startOf(range[0]))));
    };
    return { lines, indent: part.indent, inner };
  }
  const item = spot.kind === 'brackets' && spot.items[at];
  if (!item) return null;
  const inner = text.slice(...item);
  const [first = '', ...more] = inner.split('\n');
  const least = Math.min(...more.filter((line) => line.trim()).map(indentOf), Infinity);
  const rest = more.length ? `\n${indented(more.join('\n'), Number.isFinite(least) ? 2 - least : 0)}` : '';
  return { lines: `- ${first}${rest}\n`, indent: 0, inner: () => inner };
}

/** The text without a step; null where it is the only one of its list, or cannot be told from the others. */
export function removed(text: string, path: string): string | null {
  const spot = spotOf(text, parentOf(path));
  const edit = spot && removal(text, spot, numberOf(path));
  const expected = meaningOf(text);
  if (!edit || expected === undefined) return null;
  listOf(expected, parentOf(path))?.splice(numberOf(path), 1);
  return ifSays(applied(text, [edit]), expected);
}

/** The text with a step, given as YAML without indentation, at a place of a list; null where it cannot be put in. */
export function inserted(text: string, list: string, at: number, step: string): string | null {
  const spot = spotOf(text, list);
  const edit = spot && insertion(text, spot, at, sourceOf(step));
  const [expected, added] = [meaningOf(text), meaningOf(step)];
  if (!edit || expected === undefined || added === undefined) return null;
  listOf(expected, list)?.splice(at, 0, added);
  const after = ifSays(applied(text, [edit]), expected);
  return ifKeepsComments(text, after);
}

/** The text with a step moved to a place of a list, counted as before it is taken away; null where it cannot be. */
export function moved(text: string, path: string, list: string, at: number): string | null {
  if (list === path || list.startsWith(`${path}/`)) return null;
  const [from, to] = [spotOf(text, parentOf(path)), spotOf(text, list)];
  const number = numberOf(path);
  const source = from && sourceAt(text, from, path);
  if (!source || !to) return null;
  const same = parentOf(path) === list;
  if (same && (at === number || at === number + 1)) return text;
  const edits = [removal(text, from, number), insertion(text, to, at, source)];
  const expected = meaningOf(text);
  if (!edits[0] || !edits[1] || expected === undefined) return null;
  moveValue(expected, path, list, at);
  return ifKeepsComments(text, ifSays(applied(text, [edits[0], edits[1]]), expected));
}

function moveValue(value: Plain, path: string, list: string, at: number): void {
  const [from, to] = [listOf(value, parentOf(path)), listOf(value, list)];
  const step = valueAt(value, path);
  if (!from || !to || step === undefined) return;
  to.splice(at, 0, step);
  from.splice(numberOf(path) + (from === to && at <= numberOf(path) ? 1 : 0), 1);
}

/** A path after steps were put in (or, `by` below 0, taken away) at a place of a list. */
function shifted(path: string, list: string, at: number, by: number): string {
  if (!path.startsWith(`${list}/`)) return path;
  const [next = '', ...rest] = path.slice(list.length + 1).split('/');
  return Number(next) < at ? path : [list, Number(next) + by, ...rest].join('/');
}

/** The path that a step has after it was moved so. */
export function pathAfter(path: string, list: string, at: number): string {
  const [from, number] = [parentOf(path), numberOf(path)];
  if (from === list) return `${list}/${at > number ? at - 1 : at}`;
  return `${shifted(list, from, number + 1, -1)}/${at}`;
}

/** The path that any step has after an edit; null: it was taken away. */
export function pathThrough(path: string, edit: BlockEdit): string | null {
  if (edit.kind === 'change') return path;
  if (edit.kind === 'insert') return shifted(path, edit.list, edit.at, 1);
  const taken = path === edit.path || path.startsWith(`${edit.path}/`);
  if (taken && edit.kind === 'remove') return null;
  const left = shifted(path, parentOf(edit.path), numberOf(edit.path) + 1, -1);
  if (edit.kind === 'remove') return left;
  const to = pathAfter(edit.path, edit.list, edit.at);
  return taken ? to + path.slice(edit.path.length) : shifted(left, parentOf(to), numberOf(to), 1);
}

/** Where a step goes that is moved one place up or down, into the one before it, or out of the one around it. */
export function destination(
  list: List,
  path: string,
  way: 'up' | 'down' | 'into' | 'out',
): { list: string; at: number } | null {
  const around = listAround(list, path);
  if (!around) return null;
  const at = numberOf(path);
  switch (way) {
    case 'up':
      return at > 0 ? { list: around.path, at: at - 1 } : null;
    case 'down':
      return at < around.blocks.length - 1 ? { list: around.path, at: at + 2 } : null;
    case 'into': {
      const into = around.blocks[at - 1]?.lists.findLast((one) => one.open);
      return into ? { list: into.path, at: into.blocks.length } : null;
    }
    case 'out': {
      // A branch is a list in a list; elsewhere the key stands between.
      const owner = ownerOf(list, around.path);
      return owner ? { list: parentOf(owner), at: numberOf(owner) + 1 } : null;
    }
  }
}

function listAround(list: List, path: string): List | null {
  if (list.blocks.some((one) => one.path === path)) return list;
  for (const block of list.blocks) {
    if (!path.startsWith(`${block.path}/`)) continue;
    for (const below of block.lists) {
      const found = listAround(below, path);
      if (found) return found;
    }
  }
  return null;
}

/** The step that has a list. */
function ownerOf(list: List, path: string): string | null {
  for (const block of list.blocks) {
    if (block.lists.some((one) => one.path === path)) return block.path;
    if (path.startsWith(block.path)) {
      for (const below of block.lists) {
        const found = ownerOf(below, path);
        if (found) return found;
      }
    }
  }
  return null;
}
