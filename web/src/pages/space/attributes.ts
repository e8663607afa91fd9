/** What the attributes of a node say of what may be done with it. */
import type { Json } from '../../lib/protocol';

/** An attribute as the operation `node.attributes` tells it. */
export interface NodeAttribute {
  name: string;
  v: Json;
  s: number;
}

const CURRENT_WRITE = 2; // OPC 10000-3 8.57, AccessLevelType

const VALUE_RANKS: Record<number, string> = {
  [-3]: 'scalar or one dimension',
  [-2]: 'any',
  [-1]: 'scalar',
  0: 'one or more dimensions',
  1: 'one dimension',
};
const ACCESS = ['CurrentRead', 'CurrentWrite', 'HistoryRead', 'HistoryWrite', 'SemanticChange', 'StatusWrite'];

function valueOf(attributes: readonly NodeAttribute[], name: string): Json {
  return attributes.find((one) => one.name === name)?.v ?? null;
}

/** Whether this user may write the value of a node. */
export function isWritable(attributes: readonly NodeAttribute[]): boolean {
  const level = valueOf(attributes, 'UserAccessLevel');
  return typeof level === 'number' && (level & CURRENT_WRITE) !== 0;
}

/** The node's name for people. */
export function displayName(attributes: readonly NodeAttribute[]): string {
  const name = valueOf(attributes, 'DisplayName');
  return typeof name === 'string' ? name : '';
}

/** Numbers that are sets or ranks, in words beside the number. */
export function meaning(attribute: NodeAttribute): string {
  const { name, v } = attribute;
  if (typeof v !== 'number') return '';
  if (name === 'ValueRank') return VALUE_RANKS[v] ?? (v > 1 ? `${v} dimensions` : '');
  if (name === 'AccessLevel' || name === 'UserAccessLevel') {
    return ACCESS.filter((_, bit) => (v >> bit) & 1).join(', ');
  }
  return '';
}
