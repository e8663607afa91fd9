/** The tree of nodes as rows: what is below an open node follows it. */

/** A node as the operation `node.browse` tells it. */
export interface BrowsedNode {
  node: string;
  name: string;
  display: string;
  class: string;
  /** DataType of a Variable. */
  type: string | null;
  property: boolean;
  /** How many nodes are below it; null: nobody has counted. */
  below: number | null;
}

/** What is known of the nodes below one: they, that somebody asks, or why they could not be had. */
export type Below = readonly BrowsedNode[] | 'asking' | { error: string };

export interface Row {
  /** NodeIds from the root to it: a node may stand at several places. */
  path: string;
  node: BrowsedNode;
  level: number;
  expandable: boolean;
  open: boolean;
  /** Its number among its siblings from 1, and how many they are. */
  position: number;
  siblings: number;
}

/** A row that stands for what is not there: `asking`, or an error. */
export interface NoteRow {
  path: string;
  level: number;
  note: 'asking' | { error: string };
}

const SEPARATOR = '\n';

/** The path of a node below another; of a root where `above` is empty. */
export function pathOf(above: string, node: string): string {
  return above ? `${above}${SEPARATOR}${node}` : node;
}

/** The path that a node's row stands below; empty: it is a root. */
export function above(path: string): string {
  const at = path.lastIndexOf(SEPARATOR);
  return at < 0 ? '' : path.slice(0, at);
}

/** The rows that can be seen, from the top to the bottom. */
export function rowsOf(
  roots: readonly BrowsedNode[],
  below: ReadonlyMap<string, Below>,
  open: ReadonlySet<string>,
): (Row | NoteRow)[] {
  const rows: (Row | NoteRow)[] = [];
  const add = (nodes: readonly BrowsedNode[], under: string, level: number): void => {
    nodes.forEach((node, index) => {
      const path = pathOf(under, node.node);
      // A node that is reached again below itself would go on for ever.
      const expandable = node.below !== 0 && !under.split(SEPARATOR).includes(node.node);
      const is_open = expandable && open.has(path);
      rows.push({ path, node, level, expandable, open: is_open, position: index + 1, siblings: nodes.length });
      if (!is_open) return;
      const children = below.get(node.node);
      if (children === undefined) return;
      if (children === 'asking' || 'error' in children)
        rows.push({ path: pathOf(path, ''), level: level + 1, note: children });
      else add(children, path, level + 1);
    });
  };
  add(roots, '', 1);
  return rows;
}

export function isNote(row: Row | NoteRow): row is NoteRow {
  return 'note' in row;
}

/** What a key of the tree does (WAI-ARIA Authoring Practices, tree view). */
export type Move = { go: string } | { open: string } | { close: string } | null;

export function move(rows: readonly (Row | NoteRow)[], current: string, key: string): Move {
  const there = rows.filter((row): row is Row => !isNote(row));
  const at = there.findIndex((row) => row.path === current);
  const row = there[at];
  const to = (index: number): Move => {
    const target = there[Math.max(0, Math.min(there.length - 1, index))];
    return target ? { go: target.path } : null;
  };
  switch (key) {
    case 'ArrowDown':
      return to(at + 1);
    case 'ArrowUp':
      return to(Math.max(0, at - 1));
    case 'PageDown':
      return to(at + 10);
    case 'PageUp':
      return to(Math.max(0, at - 10));
    case 'Home':
      return to(0);
    case 'End':
      return to(there.length - 1);
    case 'ArrowRight':
      if (!row?.expandable) return null;
      return row.open ? to(at + 1) : { open: row.path };
    case 'ArrowLeft':
      if (row?.open) return { close: row.path };
      return row && above(row.path) ? { go: above(row.path) } : null;
    default:
      return null;
  }
}
