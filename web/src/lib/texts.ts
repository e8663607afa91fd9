/** All texts of the page, from `src/texts/en.json`: keys are checked by the compiler, none is written elsewhere. */
import en from '../texts/en.json';

type Leaves<T> = T extends string
  ? ''
  : { [K in keyof T & string]: T[K] extends string ? K : `${K}.${Leaves<T[K]>}` }[keyof T & string];

/** `section.name`; a name that ends with `_one` is taken instead of its other for `n` = 1. */
export type TextKey = Exclude<Leaves<typeof en>, `${string}_one`>;

export type TextValues = Record<string, string | number>;

const known = new Map<string, string | undefined>();

/** The same keys are asked for each second, for each of many things that are shown. */
function found(key: string): string | undefined {
  if (known.has(key)) return known.get(key);
  let at: unknown = en;
  for (const part of key.split('.')) at = (at as Record<string, unknown> | undefined)?.[part];
  const text = typeof at === 'string' ? at : undefined;
  known.set(key, text);
  return text;
}

/** A text with its `{names}` filled in. */
export function t(key: TextKey, values: TextValues = {}): string {
  const text = (values.n === 1 ? found(`${key}_one`) : undefined) ?? found(key) ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name: string) => (name in values ? String(values[name]) : whole));
}
