/**
 * What may have been carried out though no answer came.
 *
 * Each press of a command has a key, by which the console carries it out once. Until an answer comes, the same command
 * has the same key, for as long as the console is sure to know it; one that sets a state has another one each time.
 */

/** From the first press on; the console knows the key for 120 s from its answer on. */
export const KNOWN_MS = 90_000;

/** Operations that change nothing: to ask again costs nothing. */
const READ = new Set([
  'alarm.list',
  'messages.dissect',
  'node.attributes',
  'node.browse',
  'node.picture',
  'node.read',
  'node.trends',
  'resilience.preview',
  'resilience.what_if',
  'scenario.dry_run',
  'scenario.outline',
  'scenario.text',
  'scenario.validate',
]);

export const isCommand = (operation: string) => !READ.has(operation);

/** Commands that set a state, as Hold: pressed again they are meant again, whatever somebody else has said meanwhile. */
const SETS = new Set([
  'alarm.disable',
  'alarm.enable',
  'alarm.shelve',
  'alarm.suppress',
  'alarm.unshelve',
  'alarm.unsuppress',
  'fault.clear',
  'fault.raise',
  'node.write',
  'resilience.mode',
  'robots.hold',
  'robots.release',
  'run.abort',
  'run.pause',
  'run.resume',
  'skill.halt',
  'skill.resume',
  'skill.suspend',
]);

/** Whether a command whose answer was lost is not to be done a second time when it is pressed again. */
export const isDoneOnce = (operation: string) => isCommand(operation) && !SETS.has(operation);

const PLACES = {
  alarm: 'errors.unknown_alarm',
  fault: 'errors.unknown_alarm',
  node: 'errors.unknown_node',
  resilience: 'errors.unknown_resilience',
  robots: 'errors.unknown_robot',
  run: 'errors.unknown_run',
  scenario: 'errors.unknown_run',
  skill: 'errors.unknown_robot',
} as const;

/** The text that says where to look whether a command was carried out. */
export function placeToLook(operation: string): (typeof PLACES)[keyof typeof PLACES] | 'errors.unknown_other' {
  const subject = operation.split('.')[0] ?? '';
  return Object.hasOwn(PLACES, subject) ? PLACES[subject as keyof typeof PLACES] : 'errors.unknown_other';
}

/** Not `randomUUID`, which a page without TLS does not have. */
function newKey(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, '0')).join('');
}

export interface CommandKey {
  key: string;
  /** Until when the console is sure to know it; a laptop may sleep before it learns that no answer came. */
  until_ms: number;
}

/** The keys of commands whose answer was lost. */
export class Unanswered {
  #keys = new Map<string, CommandKey>();

  /** The key of a command: that of before, where the answer to the same command was lost a short time ago. */
  key(command: string, now_ms: number): CommandKey {
    for (const [one, { until_ms }] of this.#keys) if (until_ms <= now_ms) this.#keys.delete(one);
    const key = this.#keys.get(command) ?? { key: newKey(), until_ms: now_ms + KNOWN_MS };
    this.#keys.delete(command);
    return key;
  }

  /** No answer came. */
  lost(command: string, key: CommandKey): void {
    this.#keys.set(command, key);
  }
}
