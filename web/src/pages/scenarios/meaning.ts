/** What an edit of a text must leave as it is: what the text says, and its comments. */
import { Lexer } from 'yaml';
import { keysOf, parsed } from './document';

export type Plain = null | string | number | boolean | Plain[] | { [key: string]: Plain };

/** Before a scalar that is not quoted the lexer says so: a text may begin with `#` and be none. */
const SCALAR = '\u001f';

/** The comments of a text, in their order. */
export function commentsOf(text: string): string[] {
  const tokens = [...new Lexer().lex(text)];
  return tokens.filter((one, at) => one.startsWith('#') && tokens[at - 1] !== SCALAR);
}

/** What a text says, as a copy of its own; undefined where it cannot be read. */
export function meaningOf(text: string): Plain | undefined {
  const document = parsed(text);
  if (document.errors.length) return undefined;
  try {
    return JSON.parse(JSON.stringify(document.toJS() ?? null)) as Plain;
  } catch {
    return undefined; // an alias of what is not there
  }
}

/** The value at a path. */
export function valueAt(value: Plain, path: string): Plain | undefined {
  return keysOf(path).reduce<Plain | undefined>(
    (now, key) => (now && typeof now === 'object' ? (now as Record<string | number, Plain>)[key] : undefined),
    value,
  );
}

/** The list at a path, made where there is none yet. */
export function listOf(value: Plain, path: string): Plain[] | null {
  const found = valueAt(value, path);
  if (Array.isArray(found)) return found;
  const cut = path.lastIndexOf('/');
  const around = cut < 0 ? value : valueAt(value, path.slice(0, cut));
  if ((found ?? null) !== null || !around || typeof around !== 'object' || Array.isArray(around)) return null;
  return (around[path.slice(cut + 1)] = []);
}

/** The same for all values that say the same: what has keys has them in the order of the alphabet. */
const told = (value: unknown) =>
  JSON.stringify(value, (_, one: unknown) =>
    one && typeof one === 'object' && !Array.isArray(one)
      ? Object.fromEntries(Object.entries(one).sort(([a], [b]) => (a < b ? -1 : 1)))
      : one,
  );

/** A text if it says what it should, otherwise null. */
export function ifSays(after: string, expected: Plain): string | null {
  const now = meaningOf(after);
  return now !== undefined && told(now) === told(expected) ? after : null;
}

/** A text if it has the comments of another one, otherwise null. */
export function ifKeepsComments(before: string, after: string | null): string | null {
  if (after === null) return null;
  return told(commentsOf(before).sort()) === told(commentsOf(after).sort()) ? after : null;
}
