/**
 * What a step says, key by key, and edits of it: each changes the lines of that step alone, and no comment is lost. An
 * edit that would say something else than what is wanted, or lose a comment, is none: its answer is null.
 */
import { isMap, isPair, isScalar, isSeq, type Pair, type YAMLMap } from 'yaml';
import { indentOf, KINDS, type Kind, Lines, nodeAt, rangeOf, trimmedEnd } from './document';
import type { Edit } from './edits';
import { commentsOf, ifKeepsComments, ifSays, meaningOf, type Plain, valueAt } from './meaning';
import { applied } from './moves';

export type Given = null | string | number | boolean | readonly string[];

export interface Said {
  value: Given;
  /** As it is written, without quotes. */
  text: string;
  line: number;
}

/** A step's keys that have a value, and its arguments. */
export interface Fields {
  kind: Kind;
  line: number;
  said: ReadonlyMap<string, Said>;
  given: ReadonlyMap<string, Said>;
  /** Keys, and `arguments/NAME`, whose value is none that a field can have. */
  strange: readonly string[];
}

export interface Change {
  key: string;
  /** One of the step's arguments; the key is `arguments` then. */
  argument?: string;
  /** Undefined takes the key away. */
  value: Given | undefined;
  /** Keys in whose place it stands, as `robot` in that of `capacity`. */
  instead?: readonly string[];
}

/** In which order keys are written. Lists of steps come last where they have a key of their own. */
export const ORDER: Readonly<Record<Kind, readonly string[]>> = {
  task: [
    ...['task', 'description', 'skill', 'robot', 'capacity', 'capacities', 'arguments'],
    ...['after', 'timeout_s', 'retries', 'on_unknown'],
  ],
  sequence: ['sequence', 'description'],
  parallel: ['parallel', 'description'],
  if: ['if', 'description', 'timeout_s', 'then', 'else'],
  repeat: ['repeat', 'times', 'while', 'timeout_s', 'description'],
  wait: ['wait', 'until', 'event', 'timeout_s', 'on_timeout', 'description'],
  end: ['end', 'reason', 'description'],
};

type OfMap = YAMLMap<unknown, unknown>;
type OfPair = Pair<unknown, unknown>;

const keyText = (pair: OfPair) => (isScalar(pair.key) ? String(pair.key.value) : '');
const pairOf = (map: OfMap, key: string) => map.items.find((one) => isPair(one) && keyText(one) === key);

function kindOf(map: OfMap): Kind | null {
  return map.items.map(keyText).find((key): key is Kind => (KINDS as readonly string[]).includes(key)) ?? null;
}

function saidBy(node: unknown, lines: Lines, keyAt: number): Said | null {
  const line = lines.lineOf(keyAt) + 1;
  if (node === null) return { value: null, text: '', line };
  if (isScalar(node)) {
    const { value } = node;
    if (value === null) return { value, text: '', line };
    if (typeof value === 'string') return { value, text: value, line };
    if (typeof value === 'number' || typeof value === 'boolean') {
      return { value, text: node.source ?? String(value), line };
    }
    return null;
  }
  if (!isSeq(node) || !node.items.every((one) => isScalar(one) && typeof one.value === 'string')) return null;
  const value = node.items.map((one) => (isScalar(one) ? String(one.value) : ''));
  return { value, text: value.join(', '), line };
}

/** What a step says; null where it is none of a known kind. */
export function fieldsOf(text: string, path: string): Fields | null {
  const map = nodeAt(text, path);
  const kind = isMap(map) ? kindOf(map) : null;
  if (!isMap(map) || !kind) return null;
  const lines = new Lines(text);
  const strange: string[] = [];
  const read = (of: OfMap, prefix: string): Map<string, Said> => {
    const said = new Map<string, Said>();
    for (const pair of of.items) {
      const key = keyText(pair);
      const one = saidBy(pair.value, lines, rangeOf(pair.key)?.[0] ?? 0);
      if (one) said.set(key, one);
      else strange.push(prefix + key);
    }
    return said;
  };
  const said = read(map, '');
  const given = pairOf(map, 'arguments')?.value;
  return {
    ...{ kind, said, line: lines.lineOf(rangeOf(map)?.[0] ?? 0) + 1 },
    given: isMap(given) ? read(given, 'arguments/') : new Map<string, Said>(),
    strange: strange.filter((key) => key !== 'arguments' || !isMap(given)),
  };
}

/** Words that YAML of one version or another takes for something else than a text. */
const WORDS = /^(?:y|n|yes|no|on|off|true|false|null|nan|inf)$/i;
const PLAIN = /^[A-Za-z_](?:[\w .<>=+*/()-]*[\w)])?$/;

/** A text as a value of YAML, also within brackets. */
export function textOf(value: string, quoted = false): string {
  if (!quoted && PLAIN.test(value) && !WORDS.test(value)) return value;
  return JSON.stringify(value).replace(
    /[\u007f-\u009f\u2028\u2029\ufeff]/g,
    (one) => `\\u${one.charCodeAt(0).toString(16).padStart(4, '0')}`,
  );
}

function valueText(value: Given, quoted: boolean): string {
  if (typeof value === 'string') return textOf(value, quoted);
  if (typeof value === 'number') return String(value).replace(/^(-?\d+)e/, '$1.0e');
  if (value === null || typeof value === 'boolean') return String(value);
  return `[${value.map((one) => textOf(one)).join(', ')}]`;
}

/** One change as an edit of the text; null where it is none. */
function editFor(text: string, map: OfMap, change: { key: string; value: string | undefined }): Edit | null {
  const pair = pairOf(map, change.key);
  if (pair) return change.value === undefined ? removal(text, map, pair) : replacement(text, pair, change.value);
  return change.value === undefined ? null : addition(text, map, `${change.key}: ${change.value}`, change.key);
}

function replacement(text: string, pair: OfPair, value: string): Edit | null {
  const key = rangeOf(pair.key);
  const range = rangeOf(pair.value);
  if (!key) return null;
  if (!range || range[0] === range[1]) {
    const colon = /^\s*:/.exec(text.slice(key[1]))?.[0].length;
    const place = key[1] + (colon ?? 0);
    return { from: place, to: place, insert: colon === undefined ? `: ${value}` : ` ${value}` };
  }
  if (isScalar(pair.value)) {
    const whole = text.slice(...(range.slice(0, 2) as [number, number]));
    return { from: range[0], to: range[1], insert: whole.endsWith('\n') ? `${value}\n` : value };
  }
  if ((isSeq(pair.value) || isMap(pair.value)) && pair.value.flow) {
    return { from: range[0], to: range[1], insert: value };
  }
  // Lines below the key: they make room for one value behind it.
  const colon = /^\s*:/.exec(text.slice(key[1]))?.[0].length ?? 0;
  const to = trimmedEnd(text, range[0], range[1]);
  return { from: key[1] + colon, to, insert: ` ${value}` };
}

function removal(text: string, map: OfMap, pair: OfPair): Edit | null {
  const at = map.items.indexOf(pair);
  const [before, next] = [map.items[at - 1], map.items[at + 1]];
  const key = rangeOf(pair.key);
  if (!key) return null;
  const lines = new Lines(text);
  const end = endOf(text, pair);
  if (map.flow) {
    const from = before ? endOf(text, before) : key[0];
    if (before && !text.slice(from, key[0]).includes('#')) return { from, to: end, insert: '' };
    const to = (next && rangeOf(next.key)?.[0]) ?? end;
    if (next && !text.slice(end, to).includes('#')) return { from: key[0], to, insert: '' };
    const comma = /^\s*,/.exec(text.slice(end))?.[0].length ?? 0;
    return { from: key[0], to: end + comma, insert: '' };
  }
  if (before) {
    const from = lines.startOf(key[0]);
    const to = lines.after(Math.max(key[0], end - 1));
    const indent = ' '.repeat(key[0] - from);
    const kept = commentsOf(text.slice(from, to)).map((one) => `${indent}${one}\n`);
    return { from, to, insert: kept.join('') };
  }
  // What stands behind the dash: the next one comes to its place.
  const to = next && rangeOf(next.key)?.[0];
  return to ? { from: key[0], to, insert: '' } : null;
}

/** Where a key with its value ends. */
function endOf(text: string, pair: OfPair): number {
  const key = rangeOf(pair.key);
  const range = rangeOf(pair.value);
  if (!range || range[0] === range[1]) {
    const end = key?.[1] ?? 0;
    return end + (/^\s*:/.exec(text.slice(end))?.[0].length ?? 0);
  }
  return trimmedEnd(text, range[0], range[1]);
}

function addition(text: string, map: OfMap, line: string, key: string): Edit | null {
  const kind = kindOf(map);
  const order = kind ? ORDER[kind] : [];
  const rank = order.indexOf(key);
  // Behind the last one that comes before it; where the order says nothing, behind all.
  const earlier = map.items.filter((one) => rank < 0 || order.slice(0, rank).includes(keyText(one)));
  const before = earlier.at(-1);
  if (map.flow) {
    const from = before ? endOf(text, before) : (rangeOf(map)?.[0] ?? 0) + 1;
    return { from, to: from, insert: before ? `, ${line}` : line + (map.items.length ? ', ' : '') };
  }
  const range = rangeOf(map);
  if (!before || !range) return null;
  const lines = new Lines(text);
  const indent = range[0] - lines.startOf(range[0]);
  let place = lines.after(Math.max(0, endOf(text, before) - 1));
  // Comments at the end of lines below a key are further in than the key.
  for (let now = lines.lineOf(place); place < text.length; now += 1) {
    const comment = lines.at(now);
    if (!comment.trimStart().startsWith('#') || indentOf(comment) <= indent) break;
    place += comment.length;
  }
  const start = place > 0 && text[place - 1] !== '\n' ? '\n' : '';
  return { from: place, to: place, insert: `${start}${' '.repeat(indent)}${line}\n` };
}

/** Whether a value stands in quotes, which its next one keeps. */
function isQuoted(map: OfMap, key: string): boolean {
  const value = pairOf(map, key)?.value;
  return isScalar(value) && /^QUOTE/.test(String(value.type));
}

function withOne(text: string, path: string, change: Change): string | null {
  const map = nodeAt(text, path);
  if (!isMap(map)) return null;
  const { key, value } = change;
  if (change.argument !== undefined) return withArgument(text, map, change.argument, value);
  const instead = change.instead?.find((other) => other !== key && pairOf(map, other));
  const old = instead === undefined || pairOf(map, key) || value === undefined ? undefined : pairOf(map, instead);
  if (old) {
    const range = rangeOf(old.key);
    const edit = replacement(text, old, valueText(value ?? null, false));
    return range && edit && applied(text, [edit, { from: range[0], to: range[1], insert: key }]);
  }
  if (value === undefined && !pairOf(map, key)) return text;
  const edit = editFor(text, map, { key, value: value === undefined ? value : valueText(value, isQuoted(map, key)) });
  return edit && applied(text, [edit]);
}

function withArgument(text: string, map: OfMap, name: string, value: Given | undefined): string | null {
  const given = pairOf(map, 'arguments')?.value;
  const known = isMap(given) && given.items.length ? given : null;
  if (!known || (value === undefined && known.items.every((one) => keyText(one) === name))) {
    if (value === undefined && !(known && pairOf(known, name))) return text;
    const whole = value === undefined ? undefined : `{${textOf(name)}: ${valueText(value, false)}}`;
    const edit = editFor(text, map, { key: 'arguments', value: whole });
    return edit && applied(text, [edit]);
  }
  if (value === undefined && !pairOf(known, name)) return text;
  const said = value === undefined ? value : valueText(value, isQuoted(known, name));
  const edit = editFor(text, known, { key: name, value: said });
  return edit && applied(text, [edit]);
}

function expect(step: { [key: string]: Plain }, change: Change): void {
  for (const other of change.instead ?? []) if (other !== change.key) delete step[other];
  const value = change.value as Plain | undefined;
  if (change.argument === undefined) {
    if (value === undefined) delete step[change.key];
    else step[change.key] = value;
    return;
  }
  const known = step.arguments;
  const given = known && typeof known === 'object' && !Array.isArray(known) ? known : {};
  if (value === undefined) delete given[change.argument];
  else given[change.argument] = value;
  if (Object.keys(given).length) step.arguments = given;
  else delete step.arguments;
}

/** The text with changes of a step; null where they cannot be made without changing or losing something else. */
export function changed(text: string, path: string, changes: readonly Change[]): string | null {
  const expected = meaningOf(text);
  const step = expected === undefined ? undefined : valueAt(expected, path);
  if (expected === undefined || !step || typeof step !== 'object' || Array.isArray(step)) return null;
  let now: string | null = text;
  for (const change of changes) {
    expect(step, change);
    now = now && withOne(now, path, change);
    for (const other of change.instead ?? []) {
      if (other !== change.key) now = now && withOne(now, path, { key: other, value: undefined });
    }
  }
  return now && ifKeepsComments(text, ifSays(now, expected));
}
