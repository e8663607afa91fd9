/** Arguments of a skill or a Method: what is typed into a form, and the value that it stands for. */
import type { Json } from '../lib/protocol';
import { t } from '../lib/texts';

/** One argument, as the console tells it. */
export interface Argument {
  name: string;
  /** A built-in type of OPC UA, as `Double`, `Int32`, `Boolean`, `String`; `[]` at its end: an array. */
  type: string;
  help?: string;
  unit?: string;
  /** Lowest and highest value that is taken. */
  low?: number | null;
  high?: number | null;
  /** The numbers that it may have, with their names. */
  names?: Record<string, string> | null;
  /** Absent or null: it has to be given. */
  default?: Json;
}

const WHOLE: Record<string, [number, number]> = {
  SByte: [-128, 127],
  Byte: [0, 255],
  Int16: [-32768, 32767],
  UInt16: [0, 65535],
  Int32: [-2147483648, 2147483647],
  UInt32: [0, 4294967295],
  Int64: [-Number.MAX_SAFE_INTEGER, Number.MAX_SAFE_INTEGER],
  UInt64: [0, Number.MAX_SAFE_INTEGER],
};
const NUMBERS = new Set(['Float', 'Double', ...Object.keys(WHOLE)]);

/** Built-in types that are given as a text. */
const TEXTS = new Set(
  'String LocalizedText DateTime UtcTime Guid ByteString XmlElement NodeId ExpandedNodeId QualifiedName StatusCode'.split(
    ' ',
  ),
);
/** Elements that have a control each; a longer array is JSON. */
export const MOST_ELEMENTS = 32;

export type Control = 'checkbox' | 'choice' | 'number' | 'text' | 'list' | 'json';

/** What it is given with. */
export function controlOf(argument: Argument): Control {
  if (argument.type.endsWith('[]')) return 'list';
  if (argument.names && Object.keys(argument.names).length) return 'choice';
  if (argument.type === 'Boolean') return 'checkbox';
  if (NUMBERS.has(argument.type)) return 'number';
  return TEXTS.has(argument.type) ? 'text' : 'json';
}

/** What each element of an array is. */
export function elementOf(argument: Argument): Argument {
  return { ...argument, type: argument.type.slice(0, -2), default: null };
}

/** The texts of an array's elements: of JSON, or of one value a line or between commas. */
export function elementsOf(text: string): string[] {
  const trimmed = text.trim();
  if (!trimmed) return [];
  try {
    const parsed: unknown = JSON.parse(trimmed);
    if (Array.isArray(parsed)) return parsed.map((one) => (typeof one === 'string' ? one : JSON.stringify(one)));
  } catch {
    // As people type it.
  }
  return trimmed
    .replace(/^\[|\]$/g, '')
    .split(/[\n,;]/)
    .map((part) => part.trim().replace(/^"(.*)"$/, '$1'));
}

/** The limits of a number: those that are said, within those of its type; null: none. */
export function limitsOf(argument: Argument): [number, number] | null {
  const [least, most] = WHOLE[argument.type] ?? [-Infinity, Infinity];
  const limits: [number, number] = [
    Math.max(least, argument.low ?? -Infinity),
    Math.min(most, argument.high ?? Infinity),
  ];
  return limits[0] === -Infinity && limits[1] === Infinity ? null : limits;
}

/** Limits in words. */
export function limitsText([low, high]: [number, number]): string {
  if (high === Infinity) return t('form.from', { low });
  if (low === -Infinity) return t('form.up_to', { high });
  return t('form.between', { low, high });
}

/** What stands in the form at first. */
export function initialText(argument: Argument): string {
  const value = argument.default;
  if (value === undefined || value === null) return argument.type === 'Boolean' ? 'false' : '';
  return typeof value === 'string' && controlOf(argument) !== 'json' ? value : JSON.stringify(value);
}

export type Parsed = { value: Json } | { error: string };

function parseNumber(argument: Argument, text: string): Parsed {
  const value = Number(text.trim().replace(',', '.').replace('−', '-'));
  if (!text.trim() || !Number.isFinite(value)) return { error: t('form.number') };
  if (argument.type in WHOLE && !Number.isInteger(value)) return { error: t('form.whole') };
  const limits = limitsOf(argument);
  if (limits && (value < limits[0] || value > limits[1])) {
    return { error: t('form.range', { limits: limitsText(limits) }) };
  }
  return { value };
}

/** The value that a text stands for, or what is wrong with it. */
export function parseArgument(argument: Argument, text: string): Parsed {
  switch (controlOf(argument)) {
    case 'choice': {
      return Object.hasOwn(argument.names ?? {}, text) ? { value: Number(text) } : { error: t('form.missing') };
    }
    case 'checkbox':
      return { value: text === 'true' };
    case 'number':
      return text.trim() ? parseNumber(argument, text) : { error: t('form.missing') };
    case 'list': {
      const one = elementOf(argument);
      const values: Json[] = [];
      for (const [at, part] of elementsOf(text).entries()) {
        const parsed = parseArgument(one, part);
        if ('error' in parsed) return { error: t('form.element', { n: at + 1, error: parsed.error }) };
        values.push(parsed.value);
      }
      return { value: values };
    }
    case 'json': {
      if (!text.trim()) return { error: t('form.missing') };
      try {
        return { value: JSON.parse(text) as Json };
      } catch (error) {
        return { error: t('form.json', { error: (error as Error).message }) };
      }
    }
    case 'text':
      return { value: text };
  }
}
