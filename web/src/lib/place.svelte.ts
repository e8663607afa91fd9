/** Where in the page one is: `#/FLEET/PAGE/REST?name=value`, which can be linked to and survives a reload. */
import { type Place, formatPlace, parsePlace } from './places';

class Here {
  at = $state.raw<Place>(parsePlace(location.hash));

  constructor() {
    addEventListener('hashchange', () => (this.at = parsePlace(location.hash)));
  }

  get fleet(): string {
    return this.at.fleet;
  }

  get page(): string {
    return this.at.page;
  }

  /** What follows the page's name, as `['arm']` of `#/hall/robot/arm`. */
  get rest(): readonly string[] {
    return this.at.rest;
  }

  /** A value that the page keeps in the address; empty: not there. */
  query(name: string): string {
    return this.at.query[name] ?? '';
  }

  /** The address of a page of this fleet. */
  href(page: string, rest: readonly string[] = [], query: Record<string, string> = {}): string {
    return formatPlace({ fleet: this.at.fleet, page, rest, query });
  }

  go(page: string, rest: readonly string[] = [], query: Record<string, string> = {}): void {
    location.hash = this.href(page, rest, query);
  }

  goTo(place: Place): void {
    location.hash = formatPlace(place);
  }

  /** Keep values in the address, without a step in the history; an empty one is taken out. */
  keep(values: Record<string, string>): void {
    const query = Object.fromEntries(Object.entries({ ...this.at.query, ...values }).filter(([, value]) => value));
    this.at = { ...this.at, query };
    history.replaceState(null, '', formatPlace(this.at));
  }
}

export const here = new Here();
