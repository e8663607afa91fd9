/**
 * A scenario's text as blocks. Edits of them are in `moves.ts` (steps) and `fields.ts` (what a step says).
 */
import {
  type Document,
  isMap,
  isPair,
  isScalar,
  isSeq,
  type Pair,
  parseDocument,
  type YAMLMap,
  type YAMLSeq,
} from 'yaml';

export const KINDS = ['task', 'parallel', 'repeat', 'if', 'wait', 'sequence', 'end'] as const;
export type Kind = (typeof KINDS)[number];

/**
 * Why a step stays where it is: it stands alone where a list could be; its brackets have comments between the steps, of
 * which nobody could tell whose they are; its line does not begin with a dash alone.
 */
export type Fixed = '' | 'alone' | 'comments' | 'marked';

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
  /** Why it can be neither moved nor removed; empty: it can. */
  fixed: Fixed;
}

/** Steps in their order, where others can be inserted. */
export interface List {
  path: string;
  /** The key that it stands at, as `then`; empty: of a branch, or of the whole. */
  key: string;
  blocks: Block[];
  /** Whether steps can be put in. */
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

/** A text by its lines. */
export class Lines {
  readonly starts: readonly number[];

  constructor(readonly text: string) {
    this.starts = startsOf(text);
  }

  /** With its end. */
  at(line: number): string {
    return this.text.slice(this.starts[line], this.starts[line + 1] ?? this.text.length);
  }

  startOf(offset: number): number {
    return this.starts[this.lineOf(offset)] ?? 0;
  }

  /** Where the line after the one of an offset begins, or the text ends. */
  after(offset: number): number {
    return this.starts[this.lineOf(offset) + 1] ?? this.text.length;
  }

  /** Counted from 0. */
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
}

class Reader extends Lines {
  list(node: unknown, path: string, key: string, inBrackets: boolean): List {
    if (isSeq(node)) {
      const fixed = node.flow ? this.inBrackets(node) : partsOf(this.text, node) ? '' : 'marked';
      return {
        ...{ path, key, open: !fixed },
        blocks: node.items.map((item, at) => this.block(item, `${path}/${at}`, fixed)),
      };
    }
    // A single step needs no list.
    if (isMap(node)) return { path, key, blocks: [this.block(node, path, 'alone')], open: false };
    return { path, key, blocks: [], open: !inBrackets && (node === null || (isScalar(node) && node.value === null)) };
  }

  private inBrackets(list: YAMLSeq): Fixed {
    return spacesOf(this.text, list).some((one) => one.includes('#')) ? 'comments' : '';
  }

  block(node: unknown, path: string, fixed: Fixed): Block {
    const start = rangeOf(node)?.[0] ?? 0;
    const line = this.lineOf(start) + 1;
    if (isSeq(node)) {
      const lists = [this.list(node, path, '', false)];
      return { path, kind: 'branch', title: '', detail: '', line, fixed, lists };
    }
    if (!isMap(node)) return { path, kind: 'unknown', title: '', detail: '', line, lists: [], fixed };
    const keys = node.items.map((pair) => (isPair(pair) && isScalar(pair.key) ? String(pair.key.value) : ''));
    const kind = keys.find((key): key is Kind => (KINDS as readonly string[]).includes(key)) ?? 'unknown';
    const lists = (BELOW[kind] ?? []).flatMap((key) => {
      const pair = node.items.find((one) => isScalar(one.key) && one.key.value === key) as Pair | undefined;
      return pair ? [this.list(pair.value, `${path}/${key}`, key, Boolean(node.flow))] : [];
    });
    const title = kind === 'unknown' ? keys.join(', ') : textAt(node, kind);
    return { path, kind, title, detail: detailOf(kind, node), line, lists, fixed };
  }
}

function startsOf(text: string): number[] {
  const starts = [0];
  for (let at = text.indexOf('\n'); at >= 0; at = text.indexOf('\n', at + 1)) starts.push(at + 1);
  return starts;
}

const OPTIONS = { keepSourceTokens: false, prettyErrors: false, uniqueKeys: false, merge: false } as const;

let last: { text: string; document: Document.Parsed } | null = null;

/** A text read as YAML, which nobody changes. The last one is kept, since each edit looks at its text several times. */
export function parsed(text: string): Document.Parsed {
  if (last?.text !== text) last = { text, document: parseDocument(text, OPTIONS) };
  return last.document;
}

/** The keys and numbers of a path. */
export const keysOf = (path: string) => path.split('/').map((part) => (/^\d+$/.test(part) ? Number(part) : part));

/** What stands at a path of a text; undefined where the text cannot be read. */
export function nodeAt(text: string, path: string): unknown {
  const document = parsed(text);
  return document.errors.length ? undefined : document.getIn(keysOf(path), true);
}

/** Where a node begins, where its value ends, and where what belongs to it ends. */
export const rangeOf = (node: unknown) => (node as { range?: [number, number, number] } | null)?.range ?? null;

/** The blocks of a text. */
export function blocksOf(text: string): Blocks {
  const document = parsed(text);
  const [error] = document.errors;
  if (error) return { list: null, problem: error.message };
  const steps = isMap(document.contents) ? document.contents.get('steps', true) : undefined;
  return { list: new Reader(text).list(steps, 'steps', '', false), problem: '' };
}

/** The lines of an item, with comments right above it, up to the next one's. */
export interface Part {
  from: number;
  to: number;
  /** Where its dash is in its line. */
  indent: number;
  /** Whether other dashes stand before its own, as in `- - {wait: 1}`: it then begins at its dash. */
  inline: boolean;
}

/** The lines of each item; null where some have no line that begins with a dash. */
export function partsOf(text: string, list: YAMLSeq): Part[] | null {
  const lines = new Lines(text);
  const parts: Part[] = [];
  let over = -1; // the last line of the item before
  for (const item of list.items) {
    const range = rangeOf(item);
    const start = range && lines.startOf(range[0]);
    const dashes = range && start !== null ? /^( *)((?:- +)+)$/.exec(text.slice(start, range[0])) : null;
    if (!range || start === null || !dashes) return null;
    const inline = (dashes[2] ?? '').trim().length > 1;
    if (inline && parts.length) return null;
    const indent = text.slice(start, range[0]).lastIndexOf('-');
    let line = lines.lineOf(range[0]);
    const last = lines.lineOf(Math.max(range[0], trimmedEnd(text, range[0], range[1]) - 1));
    while (
      !inline &&
      line - 1 > over &&
      lines
        .at(line - 1)
        .trimStart()
        .startsWith('#') &&
      indentOf(lines.at(line - 1)) >= indent
    ) {
      line -= 1;
    }
    const from = inline ? start + indent : (lines.starts[line] ?? 0);
    parts.push({ from, to: lines.starts[last + 1] ?? text.length, indent, inline });
    over = last;
  }
  return parts;
}

/** What stands in the brackets of a list before, between and behind its items. */
export function spacesOf(text: string, list: YAMLSeq): string[] {
  const [from = 0, to = 0] = rangeOf(list) ?? [];
  const ends = list.items.flatMap((item) => rangeOf(item)?.slice(0, 2) ?? []);
  const edges = [from + 1, ...ends, to - 1];
  return edges.flatMap((edge, at) => (at % 2 ? [text.slice(edges[at - 1], edge)] : []));
}

export const indentOf = (line: string) => line.search(/\S|$/);

/** The end of an item without blank lines and comments, which follow it and belong to what comes next. */
export function trimmedEnd(text: string, from: number, to: number): number {
  const lines = text.slice(from, to).split('\n');
  let end = to;
  for (let at = lines.length - 1; at > 0; at -= 1) {
    const line = lines[at] ?? '';
    if (line.trim() && !line.trimStart().startsWith('#')) break;
    end -= line.length + 1;
  }
  return end;
}

/** A name for a task that the text does not have yet. */
export function freeTask(text: string, wanted: string): string {
  const base = wanted.replace(/\W/g, '_').replace(/^(\d)/, '_$1').slice(0, 60) || 'task';
  for (let number = 1; ; number += 1) {
    const name = number === 1 ? base : `${base}_${number}`;
    if (!new RegExp(`\\btask:\\s*["']?${name}\\b`).test(text)) return name;
  }
}
