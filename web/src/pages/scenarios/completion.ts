/** What may stand where the cursor is in a scenario's text: keys of the schema, names of the fleet and of the text. */
import schema from './scenario.schema.json';

/** What is known of the fleet. */
export interface Names {
  robots: readonly string[];
  capacities: readonly string[];
  /** Skills of the robot that the step at the cursor names, with their arguments. */
  skills: Readonly<Record<string, readonly string[]>>;
}

export interface Offer {
  label: string;
  detail?: string;
  /** Whether it is a key, to be followed by a colon. */
  key?: boolean;
}

export interface Offers {
  /** Where what is typed already begins. */
  from: number;
  offers: Offer[];
}

interface Described {
  description?: string;
  enum?: readonly unknown[];
}
type Properties = Record<string, Described>;

const KINDS = ['task', 'parallel', 'repeat', 'if', 'wait', 'sequence', 'end'] as const;
type Kind = (typeof KINDS)[number];

function propertiesOf(kind: Kind): Properties {
  return schema.$defs[kind].properties as unknown as Properties;
}

const TASKS = /(?:^|[\s{,-])task:\s*["']?([A-Za-z_]\w*)/gm;

/** The names of all tasks of a text, whether or not it can be read as a whole. */
export function tasksOf(text: string): string[] {
  return [...new Set([...text.matchAll(TASKS)].map((one) => one[1] ?? ''))];
}

/** The part of a text that is the step at a place: from its dash or brace to the place, and what follows of it. */
export function stepAt(text: string, at: number): { before: string; after: string } {
  let depth = 0;
  for (let i = at - 1; i >= 0 && text[i] !== '\n'; i -= 1) {
    if (text[i] === '}') depth += 1;
    if (text[i] === '{' && depth-- === 0) {
      // `arguments: {` belongs to the step around it.
      if (/arguments:\s*$/.test(text.slice(0, i))) {
        depth = 0;
        continue;
      }
      const end = text.slice(at).search(/\n/);
      return { before: text.slice(i + 1, at), after: end < 0 ? text.slice(at) : text.slice(at, at + end) };
    }
  }
  const lines = text.slice(0, at).split('\n');
  const last = lines.at(-1) ?? '';
  let indent = last.search(/\S|$/);
  const before = [last];
  if (!/^\s*-/.test(last)) {
    for (let i = lines.length - 2; i >= 0; i -= 1) {
      const line = lines[i] ?? '';
      if (!line.trim() || line.trim().startsWith('#')) continue;
      const dash = /^(\s*(?:-\s+)+)/.exec(line);
      const starts = dash ? (dash[1]?.length ?? 0) : line.search(/\S/);
      if (starts < indent) indent = starts;
      if (starts === indent) before.unshift(line);
      if (dash && starts <= indent) break;
      if (starts === 0) break;
    }
  }
  const end = text.indexOf('\n', at);
  const after = [text.slice(at, end < 0 ? undefined : end)];
  const base = /^\s*(?:-\s+)*/.exec(before[0] ?? '')?.[0].length ?? 0;
  for (const line of end < 0 ? [] : text.slice(end + 1).split('\n')) {
    if (line.trim() && (line.search(/\S/) < base || /^\s*-/.test(line.slice(0, base + 1)))) break;
    after.push(line);
  }
  return { before: before.join('\n'), after: after.join('\n') };
}

function valueOf(step: string, key: string): string {
  const found = new RegExp(`(?:^|[\\s{,-])${key}:\\s*["'\\[]*\\s*([^\\s,"'}\\]#]+)`, 'm').exec(step);
  return found?.[1] ?? '';
}

/** The robot, capacity and skill of the step at a place; empty ones are not named. */
export function namedAt(text: string, at: number): { robot: string; capacity: string; skill: string } {
  const { before, after } = stepAt(text, at);
  const step = `${before}${after}`;
  return {
    robot: valueOf(step, 'robot'),
    capacity: valueOf(step, 'capacity') || valueOf(step, 'capacities'),
    skill: valueOf(step, 'skill'),
  };
}

function kindOf(step: string): Kind | null {
  const places = KINDS.map((kind) => [step.search(new RegExp(`(?:^|[\\s{,-])${kind}:`, 'm')), kind] as const);
  const [first] = places.filter(([at]) => at >= 0).sort((a, b) => a[0] - b[0]);
  return first?.[1] ?? null;
}

function valuesFor(key: string, text: string, names: Names): Offer[] {
  const named = (labels: readonly string[]) => labels.map((label) => ({ label }));
  switch (key) {
    case 'skill':
      return Object.entries(names.skills).map(([label, given]) => ({ label, detail: given.join(', ') }));
    case 'robot':
      return named(names.robots);
    case 'capacity':
    case 'capacities':
      return named(names.capacities);
    case 'after':
      return named(tasksOf(text));
  }
  for (const kind of KINDS) {
    const all = propertiesOf(kind)[key]?.enum?.filter((one): one is string => typeof one === 'string');
    if (all?.length) return named(all);
  }
  return [];
}

/** What may stand at a place of a text. */
export function offersAt(text: string, at: number, names: Names): Offers | null {
  const line = text.slice(text.lastIndexOf('\n', at - 1) + 1, at);
  if (/(^|\s)#/.test(line)) return null;
  const value = /(?:^|[\s{,-])([A-Za-z_]+):\s+(?:\[(?:[^\]]*,)?\s*)?([\w-]*)$/.exec(line);
  if (value && !/\[[^\]]*$/.test(line.slice(0, value.index))) {
    const typed = value[2] ?? '';
    return { from: at - typed.length, offers: valuesFor(value[1] ?? '', text, names) };
  }
  const key = /(?:^\s*|-\s+|[{,]\s*)([A-Za-z_]\w*)?$/.exec(line);
  if (!key) return null;
  const typed = key[1] ?? '';
  const from = at - typed.length;
  const asKeys = (all: Properties): Offer[] =>
    Object.entries(all).map(([label, one]) => ({ label, detail: one.description ?? '', key: true }));
  if (!/^\s*-|[{]/.test(line) && /^\S*$/.test(line)) {
    const present = new Set([...text.matchAll(/^([a-z]+):/gm)].map((one) => one[1]));
    const top = asKeys(schema.properties as unknown as Properties);
    return { from, offers: top.filter((one) => !present.has(one.label)) };
  }
  const { before, after } = stepAt(text, at);
  const step = before.slice(0, before.length - typed.length);
  const skill = valueOf(`${before}${after}`, 'skill');
  if (/arguments:\s*\{[^}]*$/.test(step) || /arguments:\s*\n[^-]*$/.test(step)) {
    return { from, offers: (names.skills[skill] ?? []).map((label) => ({ label, key: true })) };
  }
  const kind = kindOf(`${step}\n${after}`);
  if (!kind) {
    const offers = KINDS.map((label) => ({ label, detail: propertiesOf(label)[label]?.description ?? '', key: true }));
    return { from, offers };
  }
  const has = (label: string) => new RegExp(`(?:^|[\\s{,-])${label}:`, 'm').test(`${step}\n${after}`);
  return { from, offers: asKeys(propertiesOf(kind)).filter((one) => !has(one.label)) };
}
