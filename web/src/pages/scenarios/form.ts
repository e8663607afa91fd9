/** The form of a step: which fields it has, what is typed into them, and which of the server's problems are theirs. */
import type { Problem } from '../../lib/protocol';
import { t } from '../../lib/texts';
import { type Argument, controlOf, limitsOf, limitsText } from '../../parts/arguments';
import type { Kind } from './document';
import type { Fields, Given } from './fields';
import schema from './scenario.schema.json';

/** Keys of steps that are a field each. */
export type PlainKey =
  | 'task'
  | 'skill'
  | 'after'
  | 'on_unknown'
  | 'retries'
  | 'timeout_s'
  | 'description'
  | 'if'
  | 'times'
  | 'while'
  | 'wait'
  | 'until'
  | 'event'
  | 'on_timeout'
  | 'end'
  | 'reason';
export type FieldKey = PlainKey | 'who' | 'arguments';

/** A field of a step, but for who does a task and its arguments. */
export interface StepField {
  key: PlainKey;
  control: 'text' | 'seconds' | 'whole' | 'choice' | 'names';
  choices?: readonly string[];
  /** What holds where it is left out. */
  left_out?: string;
  needed?: boolean;
  help: string;
}

interface Property {
  description?: string;
  type?: string | readonly string[];
  enum?: readonly unknown[];
  default?: unknown;
  anyOf?: readonly Property[];
}

/** Fields in the order of the form; `who` and `arguments` stand for fields of their own. */
const SHOWN: Readonly<Record<Kind, readonly FieldKey[]>> = {
  task: ['task', 'who', 'skill', 'arguments', 'after', 'on_unknown', 'retries', 'timeout_s', 'description'],
  sequence: ['description'],
  parallel: ['description'],
  if: ['if', 'timeout_s', 'description'],
  repeat: ['times', 'while', 'timeout_s', 'description'],
  wait: ['wait', 'until', 'event', 'timeout_s', 'on_timeout', 'description'],
  end: ['end', 'reason', 'description'],
};

const NEEDED = new Set<FieldKey>(['task', 'skill', 'if', 'end']);

export const fieldKeys = (kind: Kind) => SHOWN[kind];

/** A field by its key, as the format's schema describes it; null: it has a form of its own. */
export function fieldOf(kind: Kind, key: FieldKey): StepField | null {
  const property = (schema.$defs[kind].properties as unknown as Record<string, Property>)[key];
  if (!property || key === 'arguments' || key === 'who') return null;
  const types = new Set([property.type ?? property.anyOf?.map((one) => one.type)].flat(2));
  const choices = property.enum?.filter((one): one is string => typeof one === 'string');
  const control = choices
    ? 'choice'
    : types.has('array')
      ? 'names'
      : types.has('integer')
        ? 'whole'
        : types.has('number') && !types.has('boolean')
          ? 'seconds'
          : 'text';
  return {
    ...{ key, control, help: (property.description ?? '').replaceAll('`', ''), needed: NEEDED.has(key) },
    ...(choices ? { choices } : {}),
    ...(property.default === undefined ? {} : { left_out: String(property.default) }),
  };
}

export type Typed = { value: Given | undefined } | { error: string };

function numberOf(typed: string): number | null {
  const text = typed.trim().replace(',', '.').replace('−', '-');
  const value = Number(text);
  return text && Number.isFinite(value) ? value : null;
}

/** What is typed into a field, as a value of the step; nothing typed: it is left out. */
export function typedInto(field: StepField, typed: string): Typed {
  const text = typed.trim();
  if (!text) {
    // `wait:` alone waits for what its other keys say.
    if (field.key === 'wait') return { value: null };
    return field.needed ? { error: t('form.missing') } : { value: undefined };
  }
  switch (field.control) {
    case 'seconds':
    case 'whole': {
      const value = numberOf(text);
      if (value === null) return { error: t('form.number') };
      return field.control === 'whole' && !Number.isInteger(value) ? { error: t('form.whole') } : { value };
    }
    case 'names':
      return { value: text.split(',').flatMap((one) => one.trim() || []) };
    default:
      return { value: text };
  }
}

/** What is typed as an argument: a value of its type, a number with its unit, or an expression after `=`. */
export function typedArgument(argument: Argument | null, typed: string): Typed {
  const text = typed.trim();
  if (!text) return { value: undefined };
  if (text.startsWith('=')) return { value: text };
  const value = numberOf(text);
  const control = argument && controlOf(argument);
  if (control === 'text') return { value: typed };
  if (control === 'checkbox' || /^(true|false)$/.test(text)) {
    return /^(true|false)$/.test(text) ? { value: text === 'true' } : { error: t('scenarios.true_false') };
  }
  if (value === null) return argument && control === 'choice' ? { error: t('form.number') } : { value: text };
  const limits = argument && limitsOf(argument);
  if (limits && (value < limits[0] || value > limits[1])) {
    return { error: t('form.range', { limits: limitsText(limits) }) };
  }
  return { value };
}

/** What is said of an argument beside its name. */
export function helpOf(argument: Argument): string {
  const limits = limitsOf(argument);
  const said = (argument.low ?? argument.high ?? null) !== null && limits ? limitsText(limits) : '';
  const names = Object.entries(argument.names ?? {}).map(([number, name]) => `${number} ${name}`);
  const left = argument.default;
  const parts = [
    argument.help,
    said && !argument.help?.includes(said) ? said : '',
    names.join(', '),
    left === undefined || left === null ? t('scenarios.argument_needed') : '',
  ];
  return parts.filter(Boolean).join(' · ');
}

const CONDITIONS: Partial<Record<Kind, string>> = { if: 'if', repeat: 'while', wait: 'until' };

/** `steps/0/parallel/1` as the server writes it: `steps[0].parallel[1]`. */
const asServer = (path: string) => path.replace(/\/(\d+)/g, '[$1]').replaceAll('/', '.');

/** Which key of a step a problem is about that tells only its line; empty: of the whole step. */
function keyMeant(what: string, fields: Fields): string {
  const argument = /argument '([^']+)'/.exec(what)?.[1];
  if (argument !== undefined) return `arguments/${argument}`;
  if (/there is no robot/.test(what)) return 'who';
  if (/ the skill '|has no skill '/.test(what)) return 'skill';
  if (/ comes after |^tasks wait for each other/.test(what)) return 'after';
  if (/there is no event/.test(what)) return 'event';
  const value = /^task '[^']*': (\w+)(?: is |:| has no unit)/.exec(what)?.[1];
  if (value !== undefined && fields.given.has(value)) return `arguments/${value}`;
  return /is never reached/.test(what) ? '' : (CONDITIONS[fields.kind] ?? '');
}

/**
 * The problems of the step at a path, by its fields: `who`, `arguments/NAME`, a key, or '' for the whole step. What is
 * wrong with the text by itself begins with its path; what does not fit the fleet tells the step's line and its name.
 */
export function problemsOf(path: string, fields: Fields, problems: readonly Problem[]): Map<string, string[]> {
  const found = new Map<string, string[]>();
  const name = fields.said.get('task')?.text;
  const own = asServer(path);
  const shown: readonly string[] = fieldKeys(fields.kind);
  for (const { line, message } of problems) {
    const [, place, rest = ''] = /^(steps[\w.[\]]*): ([^]*)$/.exec(message) ?? [];
    let key: string;
    if (place !== undefined) {
      if (place !== own && !place.startsWith(`${own}.`)) continue;
      key = place.slice(own.length + 1).replace('arguments.', 'arguments/');
      if (/^(?:then|else|repeat|sequence|parallel)[.[]/.test(key)) continue; // of a step below
      if (/needs either a `robot`/.test(rest)) key = 'who';
    } else {
      const task = /^task '([^']*)'/.exec(message)?.[1];
      if (line !== fields.line || (task !== undefined && task !== name)) continue;
      key = keyMeant(message, fields);
    }
    if (['robot', 'capacity', 'capacities'].includes(key)) key = 'who';
    const known = key.startsWith('arguments/') || shown.includes(key) ? key : '';
    const said = place === undefined ? message.replace(/^task '[^']*': /, '') : rest;
    found.set(known, [...(found.get(known) ?? []), said]);
  }
  return found;
}
