/** A scenario's text held against the fleet by the server, while it is written. */
import type { Problem } from '../../lib/protocol';
import { operation } from '../../lib/requests';
import { session } from '../../lib/session.svelte';

const WAIT_MS = 300;

/** Who has looked at the text: nobody yet, the server at the fleet or at the text alone, or nobody could. */
export type Checked = 'asking' | 'fleet' | 'text' | 'failed';

/**
 * The server says what is wrong, a moment after the last key; who may not ask it is told what the text says by itself.
 * Made while a component is made.
 */
export class Checking {
  problems = $state.raw<readonly Problem[]>([]);
  checked = $state<Checked>('asking');

  /** @param text what is checked; null: nothing can be, and what was found stays */
  constructor(fleet: () => string, text: () => string | null) {
    $effect(() => {
      const [of, scenario] = [fleet(), text()];
      if (scenario === null || !scenario.trim()) return;
      const whole = session.may(of, 'scenario.validate');
      this.checked = 'asking';
      let over = false;
      const timer = setTimeout(() => void this.#ask(of, scenario, whole, () => over), WAIT_MS);
      return () => {
        over = true;
        clearTimeout(timer);
      };
    });
  }

  async #ask(fleet: string, scenario: string, whole: boolean, isOver: () => boolean): Promise<void> {
    try {
      const asked = whole ? 'scenario.validate' : 'scenario.outline';
      const found = await operation<{ problems: Problem[] }>(fleet, asked, { scenario });
      if (isOver()) return;
      // The server's texts begin with the line, which is shown beside them.
      const told = found.problems.map((one) => ({
        ...one,
        message: one.message.replace(new RegExp(`^${one.line}:\\s*`), ''),
      }));
      if (told.length || this.problems.length) this.problems = told;
      this.checked = whole ? 'fleet' : 'text';
    } catch {
      if (!isOver()) this.checked = 'failed';
    }
  }
}
