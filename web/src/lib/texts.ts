/** All texts of the page, from `src/texts/en.json`: keys are checked by the compiler, none is written elsewhere. */
import en from '../texts/en.json';

type Leaves<T> = T extends string
  ? ''
  : { [K in keyof T & string]: T[K] extends string ? K : `${K}.${Leaves<T[K]>}` }[keyof T & string];

/** `section.name`; a name that ends with `_one` is taken instead of its other for `n` = 1. */
export type TextKey = Exclude<Leaves<typeof en>, `${string}_one`>;

export type TextValues = Record<string, string | number>;

function found(key: string): string | undefined {
  let at: unknown = en;
  for (const part of key.split('.')) at = (at as Record<string, unknown> | undefined)?.[part];
  return typeof at === 'string' ? at : undefined;
}

/** A text with its `{names}` filled in. */
export function t(key: TextKey, values: TextValues = {}): string {
  const text = (values.n === 1 ? found(`${key}_one`) : undefined) ?? found(key) ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name: string) => (name in values ? String(values[name]) : whole));
}
