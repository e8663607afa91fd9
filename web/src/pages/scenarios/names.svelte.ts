/** The names that a scenario's text may say: robots and capacities of the fleet, and the skills at the cursor. */
import { useFeed } from '../../lib/live.svelte';
import type { Argument } from '../../parts/arguments';
import { namedAt, type Names } from './completion';

interface Robot {
  name: string;
  capacities: string[];
}

/** Made while a component is made. Skills are those of one robot, since a fleet may have thousands. */
export class NamesOfFleet {
  readonly #robots;
  readonly #robot;

  constructor(fleet: () => string, text: () => string, cursor: () => number) {
    this.#robots = useFeed<Robot>(() => ({ fleet: fleet(), feed: 'robots' }));
    // Of the robot that the step at the cursor names, or of the first one that has its capacity.
    const looked = $derived.by(() => {
      const named = namedAt(text(), cursor());
      const all = [...this.#robots.entries.values()];
      if (named.robot) return all.some((one) => one.name === named.robot) ? named.robot : '';
      const able = named.capacity && all.find((one) => one.capacities.includes(named.capacity))?.name;
      return able || all[0]?.name || '';
    });
    this.#robot = useFeed<{ name: string; arguments: Argument[] }>(() =>
      looked ? { fleet: fleet(), feed: 'robot', parameters: { robot: looked } } : null,
    );
  }

  readonly names = $derived.by((): Names => {
    const robots = this.#robots.entries;
    return {
      robots: [...robots.keys()],
      capacities: [...new Set([...robots.values()].flatMap((one) => one.capacities))].sort(),
      skills: Object.fromEntries(
        [...this.#robot.entries]
          .filter(([key]) => key.startsWith('skill/'))
          .map(([, skill]) => [skill.name, skill.arguments.map((one) => one.name)]),
      ),
    };
  });
}
