/** What can be put into a scenario: its text, by what the fleet has. */
import type { Argument } from '../../parts/arguments';
import type { Kind } from './document';

/** Steps around others, and those that are no task: each with something in it that can be read. */
export const FRAMES: Readonly<Partial<Record<Kind, string>>> = {
  sequence: 'sequence:\n  - {wait: 1}',
  parallel: 'parallel:\n  - {wait: 1}\n  - {wait: 1}',
  repeat: 'repeat:\n  - {wait: 1}\ntimes: 2',
  if: 'if: true\nthen:\n  - {wait: 1}',
  wait: '{wait: 1}',
};

function valueOf(argument: Argument): string {
  if (argument.type === 'Boolean') return 'false';
  if (argument.type === 'String' || argument.type.endsWith('[]')) return '""';
  return String(argument.low ?? 0);
}

/** A text as a value of YAML within braces. */
export const quoted = (text: string) => (/^[A-Za-z_][\w-]*$/.test(text) ? text : JSON.stringify(text));

/** A task in one line; arguments that have to be given stand there to be filled in. */
export function taskText(
  name: string,
  skill: string,
  who: { robot: string } | { capacity: string },
  given: readonly Argument[],
): string {
  const needed = given.filter((one) => one.default === null || one.default === undefined);
  const values = needed.map((one) => `${quoted(one.name)}: ${valueOf(one)}`).join(', ');
  const by = 'robot' in who ? `robot: ${quoted(who.robot)}` : `capacity: ${quoted(who.capacity)}`;
  return `{task: ${name}, skill: ${quoted(skill)}, ${by}${values ? `, arguments: {${values}}` : ''}}`;
}
