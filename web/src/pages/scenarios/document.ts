/**
 * A scenario's text as blocks, and edits of it as small changes of the text: what is not moved, removed or inserted
 * stays to the sign, comments too. Comments right above a step, and at the end of its lines, go with it.
 *
 * Only lists of one item a line can be edited so (`- …`); steps in brackets (`[{…}, {…}]`) are shown, and edited as text.
 */
import { isMap, isPair, isScalar, isSeq, type Pair, parseDocument, type YAMLMap, type YAMLSeq } from 'yaml';
import type { Edit } from './edits';

export const KINDS = ['task', 'parallel', 'repeat', 'if', 'wait', 'sequence', 'end'] as const;
export type Kind = (typeof KINDS)[number];

/** A step, or the branch of `parallel` that is a list. */
export interface Block {
  /** Where it is in the document, as `steps/1/parallel/0`. */
  path: string;
  kind: Kind | 'branch' | 'unknown';
  /** Its name or condition. */
  title: string;
  /** What is said of it beside: skill and who does it, `after`, how often. */
  detail: string;
  line: number;
  lists: List[];
  /** Whether it can be moved and removed by its lines. */
  movable: boolean;
}

/** Steps in their order, where others can be inserted. */
export interface List {
  path: string;
  /** The key that it stands at, as `then`; empty: of a branch, or of the whole. */
  key: string;
  blocks: Block[];
  /** Whether its steps are a line or more each, so that lines can be put in. */
  open: boolean;
}

export interface Blocks {
  /** Null: the text cannot be read, and `problem` says why. */
  list: List | null;
  problem: string;
}

/** Keys at which steps stand, by the kind of step. */
const BELOW: Partial<Record<Block['kind'], readonly string[]>> = {
  sequence: ['sequence'],
  parallel: ['parallel'],
  repeat: ['repeat'],
  if: ['then', 'else'],
};

function textAt(map: YAMLMap, key: string): string {
  const value: unknown = map.get(key, true);
  if (isScalar(value)) return value.value === null ? '' : String(value.value);
  if (isSeq(value)) return value.items.flatMap((one) => (isScalar(one) ? [String(one.value)] : [])).join(', ');
  return '';
}

function detailOf(kind: Block['kind'], map: YAMLMap): string {
  const parts = (...keys: string[]) => keys.map((key) => textAt(map, key)).filter(Boolean);
  switch (kind) {
    case 'task': {
      const who = parts('robot', 'capacity', 'capacities').join(', ');
      const after = textAt(map, 'after');
      return [textAt(map, 'skill'), who && `→ ${who}`, after && `⇠ ${after}`].filter(Boolean).join(' ');
    }
    case 'repeat':
      return parts('times')
        .map((one) => `× ${one}`)
        .concat(parts('while'))
        .join(', ');
    case 'wait':
      return parts('until', 'event').join(', ');
    case 'end':
      return textAt(map, 'reason');
    default:
      return '';
  }
}

class Reader {
  constructor(
    readonly text: string,
    readonly starts: readonly number[],
  ) {}

  lineOf(offset: number): number {
    let low = 0;
    let high = this.starts.length;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if ((this.starts[middle] ?? 0) <= offset) low = middle;
      else high = middle;
    }
    return low;
  }

  /** Whether only a dash and spaces stand before an item on its line, so that its lines are its own. */
  ownLines(offset: number): boolean {
    return /^ *- +$/.test(this.text.slice(this.starts[this.lineOf(offset)] ?? 0, offset));
  }

  list(node: unknown, path: string, key: string): List {
    if (!isSeq(node)) {
      // A single step needs no list.
      return { path, key, blocks: isMap(node) ? [this.block(node, path, false)] : [], open: false };
    }
    const open = !node.flow && node.items.length > 0;
    return {
      ...{ path, key, open },
      blocks: node.items.map((item, at) => this.block(item, `${path}/${at}`, open)),
    };
  }

  block(node: unknown, path: string, inLines: boolean): Block {
    const start = (node as { range?: [number, number, number] } | null)?.range?.[0] ?? 0;
    const movable = inLines && this.ownLines(start);
    const line = this.lineOf(start) + 1;
    if (isSeq(node)) {
      return { ...{ path, kind: 'branch', title: '', detail: '', line, movable }, lists: [this.list(node, path, '')] };
    }
    if (!isMap(node)) return { path, kind: 'unknown', title: '', detail: '', line, lists: [], movable };
    const keys = node.items.map((pair) => (isPair(pair) && isScalar(pair.key) ? String(pair.key.value) : ''));
    const kind = keys.find((key): key is Kind => (KINDS as readonly string[]).includes(key)) ?? 'unknown';
    const lists = (BELOW[kind] ?? []).flatMap((key) => {
      const pair = node.items.find((one) => isScalar(one.key) && one.key.value === key) as Pair | undefined;
      return pair ? [this.list(pair.value, `${path}/${key}`, key)] : [];
    });
    const title = kind === 'unknown' ? keys.join(', ') : textAt(node, kind);
    return { path, kind, title, detail: detailOf(kind, node), line, lists, movable };
  }
}

function startsOf(text: string): number[] {
  const starts = [0];
  for (let at = text.indexOf('\n'); at >= 0; at = text.indexOf('\n', at + 1)) starts.push(at + 1);
  return starts;
}

const OPTIONS = { keepSourceTokens: false, prettyErrors: false, uniqueKeys: false, merge: false } as const;

/** The blocks of a text. */
export function blocksOf(text: string): Blocks {
  const document = parseDocument(text, OPTIONS);
  const [error] = document.errors;
  if (error) return { list: null, problem: error.message };
  const steps = isMap(document.contents) ? document.contents.get('steps', true) : undefined;
  return { list: new Reader(text, startsOf(text)).list(steps, 'steps', ''), problem: '' };
}

/** The lines of an item, with comments right above it, up to the next one's. */
interface Part {
  from: number;
  to: number;
  /** Where its dash is in its line. */
  indent: number;
}

function listAt(text: string, path: string): YAMLSeq | null {
  const document = parseDocument(text, OPTIONS);
  if (document.errors.length) return null;
  const node = document.getIn(
    path.split('/').map((part) => (/^\d+$/.test(part) ? Number(part) : part)),
    true,
  );
  return isSeq(node) && !node.flow ? node : null;
}

function partsOf(text: string, list: YAMLSeq): Part[] | null {
  const reader = new Reader(text, startsOf(text));
  const lineText = (line: number) => text.slice(reader.starts[line], reader.starts[line + 1] ?? text.length);
  const parts: Part[] = [];
  let over = -1; // the last line of the item before
  for (const item of list.items) {
    const range = (item as { range?: [number, number, number] } | null)?.range;
    if (!range || !reader.ownLines(range[0])) return null;
    let line = reader.lineOf(range[0]);
    const indent = lineText(line).indexOf('-');
    const last = reader.lineOf(Math.max(range[0], trimmedEnd(text, range[0], range[1]) - 1));
    while (
      line - 1 > over &&
      lineText(line - 1)
        .trimStart()
        .startsWith('#') &&
      indentOf(lineText(line - 1)) >= indent
    ) {
      line -= 1;
    }
    parts.push({ from: reader.starts[line] ?? 0, to: reader.starts[last + 1] ?? text.length, indent });
    over = last;
  }
  return parts;
}

const indentOf = (line: string) => line.search(/\S|$/);

/** The end of an item without blank lines and comments, which follow it and belong to what comes next. */
function trimmedEnd(text: string, from: number, to: number): number {
  const lines = text.slice(from, to).split('\n');
  let end = to;
  for (let at = lines.length - 1; at > 0; at -= 1) {
    const line = lines[at] ?? '';
    if (line.trim() && !line.trimStart().startsWith('#')) break;
    end -= line.length + 1;
  }
  return end;
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

function applied(text: string, edits: Edit[]): string {
  return [...edits]
    .sort((a, b) => b.from - a.from)
    .reduce((now, edit) => now.slice(0, edit.from) + edit.insert + now.slice(edit.to), text);
}

/** Where lines of a new item at a place of a list go. */
function placeIn(text: string, parts: readonly Part[], at: number): number {
  return parts[at]?.from ?? parts.at(-1)?.to ?? text.length;
}

/** The text without a step; null where its lines are not its own, or it is the only one of its list. */
export function removed(text: string, path: string): string | null {
  const list = listAt(text, parentOf(path));
  const parts = list && partsOf(text, list);
  const part = parts?.[numberOf(path)];
  if (!part || parts.length < 2) return null;
  return applied(text, [{ from: part.from, to: part.to, insert: '' }]);
}

/** The text with a step, given as YAML without indentation, at a place of a list; null where no lines can be put in. */
export function inserted(text: string, list: string, at: number, step: string): string | null {
  const found = listAt(text, list);
  const parts = found && partsOf(text, found);
  const first = parts?.[0];
  if (!parts || !first) return null;
  const place = placeIn(text, parts, at);
  const spaces = ' '.repeat(first.indent);
  const line = `${spaces}- ${step.replaceAll('\n', `\n${spaces}  `)}\n`;
  const before = place > 0 && text[place - 1] !== '\n' ? '\n' : '';
  return applied(text, [{ from: place, to: place, insert: before + line }]);
}

/** The text with a step moved to a place of a list, counted as before it is taken away; null where it cannot be. */
export function moved(text: string, path: string, list: string, at: number): string | null {
  if (list === path || list.startsWith(`${path}/`)) return null;
  const from = listAt(text, parentOf(path));
  const to = listAt(text, list);
  const sources = from && partsOf(text, from);
  const targets = to && partsOf(text, to);
  const part = sources?.[numberOf(path)];
  const first = targets?.[0];
  if (!part || !first) return null;
  if (parentOf(path) !== list && sources.length < 2) return null; // an empty list is none
  const place = placeIn(text, targets, at);
  if (place >= part.from && place <= part.to) return text;
  const lines = indented(withEnd(text.slice(part.from, part.to)), first.indent - part.indent);
  const before = place > 0 && text[place - 1] !== '\n' ? '\n' : '';
  return applied(text, [
    { from: part.from, to: part.to, insert: '' },
    { from: place, to: place, insert: before + lines },
  ]);
}

/** The path that a step has after it was moved so. */
export function pathAfter(path: string, list: string, at: number): string {
  const from = parentOf(path);
  const number = numberOf(path);
  if (from === list) return `${list}/${at > number ? at - 1 : at}`;
  // Those behind it, and what is in them, have a lower number now.
  const [next = '', ...rest] = list.startsWith(`${from}/`) ? list.slice(from.length + 1).split('/') : [];
  const shifted = next && Number(next) > number ? [from, Number(next) - 1, ...rest].join('/') : list;
  return `${shifted}/${at}`;
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

/** A name for a task that the text does not have yet. */
export function freeTask(text: string, wanted: string): string {
  const base = wanted.replace(/\W/g, '_').replace(/^(\d)/, '_$1').slice(0, 60) || 'task';
  for (let number = 1; ; number += 1) {
    const name = number === 1 ? base : `${base}_${number}`;
    if (!new RegExp(`\\btask:\\s*["']?${name}\\b`).test(text)) return name;
  }
}
