/** The name that a scenario's text gives itself, as `name: hand_over`. */
const NAME = /^(name:[ \t]*)(["']?)([^\s"'#]*)\2/m;

export const NAMES = /^[A-Za-z][A-Za-z0-9_-]{0,63}$/;

export function nameOf(text: string): string {
  return NAME.exec(text)?.[3] ?? '';
}

/** The same text with another name, and nothing else changed. */
export function renamed(text: string, name: string): string {
  return NAME.test(text) ? text.replace(NAME, (_, key: string) => `${key}${name}`) : `name: ${name}\n${text}`;
}

/** A name that is not there yet. */
export function freeName(wanted: string, taken: (name: string) => boolean): string {
  for (let number = 1; ; number += 1) {
    const name = number === 1 ? wanted : `${wanted}_${number}`;
    if (!taken(name)) return name;
  }
}
