/** Parameters of a scenario as arguments of a form, and as the texts that a run is started with. */
import type { Json } from '../../lib/protocol';
import type { Argument } from '../../parts/arguments';
import type { Parameter } from './types';

function typeOf(parameter: Parameter): string {
  if (typeof parameter.default === 'boolean') return 'Boolean';
  if (typeof parameter.default === 'number') return 'Double';
  // Without a default its range or unit says that it is a number.
  if (parameter.default === null && (parameter.low !== null || parameter.unit)) return 'Double';
  return 'String';
}

export function argumentsOf(parameters: readonly Parameter[]): Argument[] {
  return parameters.map((one) => ({ ...one, type: typeOf(one) }));
}

/** An empty text is one that was not given: the server says which are missing. */
export function textsOf(values: Record<string, Json>): Record<string, string> {
  return Object.fromEntries(
    Object.entries(values).flatMap(([name, value]) => (value === '' ? [] : [[name, String(value)]])),
  );
}
