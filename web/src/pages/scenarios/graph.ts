/** The steps of a run as a graph that goes from left to right or down: where each stands, what follows what. Pure. */
import { groupedBy, placeOf } from './runs';
import type { Outline, Step, TaskRow } from './types';

export interface GraphNode {
  /** The step's key; of the dots around what is side by side with `fork` or `join` behind it. */
  id: string;
  kind: Exclude<Step['kind'], 'parallel' | 'sequence'> | 'dot';
  x: number;
  y: number;
  width: number;
  height: number;
  step: Step;
  /** A task's last repetition that it has come to. */
  task: TaskRow | null;
  /** How many repetitions it has come to. */
  times: number;
}

export interface GraphEdge {
  id: string;
  from: string;
  to: string;
  /** `back` is to the next repetition; `after` is what a task waits for besides the order. */
  kind: 'order' | 'then' | 'else' | 'back' | 'after';
  /** How far on its way it turns, from 0 to 1; without it in the middle. */
  bend?: number;
}

export interface Graph {
  nodes: GraphNode[];
  edges: GraphEdge[];
  width: number;
  height: number;
}

/** Where the order goes: down where there is no room beside each other. */
export type Way = 'right' | 'down';

export const NODE = { width: 190, height: 64 };
const DOT = 12;
/** Between steps that follow each other, and between those side by side. */
const GAPS: Record<Way, { x: number; y: number }> = { right: { x: 64, y: 24 }, down: { x: 32, y: 16 } };
/** Room above and below a repetition for the way back. */
const BACK = 24;

interface Size {
  width: number;
  height: number;
}

const turned = <T extends Size>(one: T): T => ({ ...one, width: one.height, height: one.width });

/** What edges come into and go out of. */
interface Ends {
  entries: string[];
  /** With what the edge that goes on from there is. */
  exits: { id: string; kind: GraphEdge['kind'] }[];
}

/** Lays steps out from left to right; what is to go down is turned afterwards, so its steps are high and narrow here. */
class Layout {
  readonly nodes: GraphNode[] = [];
  readonly edges: GraphEdge[] = [];
  private readonly sizes = new Map<Step, Size>();
  private readonly rows: Map<string, TaskRow[]>;

  private readonly size: Size;
  private readonly gap: { x: number; y: number };

  constructor(tasks: readonly TaskRow[], way: Way) {
    this.size = way === 'down' ? turned(NODE) : NODE;
    this.gap = GAPS[way];
    this.rows = groupedBy(tasks, (one) => placeOf(one.step));
  }

  sizeOf(step: Step): Size {
    const known = this.sizes.get(step);
    if (known) return known;
    const size = this.measured(step);
    this.sizes.set(step, size);
    return size;
  }

  private measured(step: Step): Size {
    switch (step.kind) {
      case 'sequence':
        return this.row(step.steps);
      case 'parallel': {
        const branches = this.column(step.steps.map((one) => this.sizeOf(one)));
        return { width: branches.width + 2 * (DOT + this.gap.x), height: Math.max(DOT, branches.height) };
      }
      case 'if': {
        const ways = this.column([step.then, step.else].filter((one) => one.length).map((one) => this.row(one)));
        return {
          width: this.size.width + (ways.width && this.gap.x + ways.width),
          height: Math.max(this.size.height, ways.height),
        };
      }
      case 'repeat': {
        const body = this.row(step.steps);
        const width = this.size.width + (body.width && this.gap.x + body.width);
        return { width, height: Math.max(this.size.height, body.height) + 2 * BACK };
      }
      default:
        return this.size;
    }
  }

  private row(steps: readonly Step[]): Size {
    const sizes = steps.map((one) => this.sizeOf(one));
    return {
      width: sizes.reduce((sum, one) => sum + one.width, 0) + this.gap.x * Math.max(0, sizes.length - 1),
      height: Math.max(0, ...sizes.map((one) => one.height)),
    };
  }

  private column(sizes: readonly Size[]): Size {
    return {
      width: Math.max(0, ...sizes.map((one) => one.width)),
      height: sizes.reduce((sum, one) => sum + one.height, 0) + this.gap.y * Math.max(0, sizes.length - 1),
    };
  }

  private node(id: string, kind: GraphNode['kind'], step: Step, x: number, middle: number): void {
    const size = kind === 'dot' ? { width: DOT, height: DOT } : this.size;
    const rows = kind === 'task' ? (this.rows.get(step.step) ?? []) : [];
    const own = { id, kind, step, task: rows.at(-1) ?? null, times: rows.length };
    this.nodes.push({ ...own, ...size, x, y: middle - size.height / 2 });
  }

  private connect(from: Ends['exits'], to: readonly string[]): void {
    for (const { id, kind } of from) {
      for (const target of to) this.edges.push({ id: `${id} ${kind} ${target}`, from: id, to: target, kind });
    }
  }

  /** Steps one after the other, from x on, around a height. */
  steps(steps: readonly Step[], x: number, middle: number): Ends {
    const ends: Ends = { entries: [], exits: [] };
    let from = x;
    steps.forEach((step, at) => {
      const { entries, exits } = this.place(step, from, middle);
      if (at === 0) ends.entries = entries;
      else if (entries.length) this.connect(ends.exits, entries);
      if (at === 0 || entries.length) ends.exits = exits;
      from += this.sizeOf(step).width + this.gap.x;
    });
    return ends;
  }

  private place(step: Step, x: number, middle: number): Ends {
    switch (step.kind) {
      case 'sequence':
        return this.steps(step.steps, x, middle);
      case 'parallel':
        return this.parallel(step, step.steps, x, middle);
      case 'if':
        return this.condition(step, x, middle);
      case 'repeat': {
        this.node(step.step, 'repeat', step, x, middle);
        const body = this.steps(step.steps, x + this.size.width + this.gap.x, middle);
        this.connect([{ id: step.step, kind: 'order' }], body.entries);
        this.connect(
          body.exits.map(({ id }) => ({ id, kind: 'back' })),
          [step.step],
        );
        return { entries: [step.step], exits: body.exits };
      }
      default: {
        this.node(step.step, step.kind, step, x, middle);
        // Nothing follows the end of a run.
        return { entries: [step.step], exits: step.kind === 'end' ? [] : [{ id: step.step, kind: 'order' }] };
      }
    }
  }

  private parallel(step: Step, branches: readonly Step[], x: number, middle: number): Ends {
    const { width, height } = this.sizeOf(step);
    const [fork, join] = [`${step.step} fork`, `${step.step} join`];
    this.node(fork, 'dot', step, x, middle);
    this.node(join, 'dot', step, x + width - DOT, middle);
    let top = middle - height / 2;
    for (const branch of branches) {
      const size = this.sizeOf(branch);
      const ends = this.place(branch, x + DOT + this.gap.x, top + size.height / 2);
      this.connect([{ id: fork, kind: 'order' }], ends.entries);
      this.connect(ends.exits, [join]);
      top += size.height + this.gap.y;
    }
    return { entries: [fork], exits: [{ id: join, kind: 'order' }] };
  }

  private condition(step: Step & { kind: 'if' }, x: number, middle: number): Ends {
    this.node(step.step, 'if', step, x, middle);
    const ways = (['then', 'else'] as const).map((kind) => ({ kind, steps: step[kind] }));
    const used = ways.filter((one) => one.steps.length);
    let top = middle - this.column(used.map((one) => this.row(one.steps))).height / 2;
    const exits: Ends['exits'] = [];
    for (const { kind, steps } of ways) {
      if (!steps.length) {
        exits.push({ id: step.step, kind });
        continue;
      }
      const { height } = this.row(steps);
      const ends = this.steps(steps, x + this.size.width + this.gap.x, top + height / 2);
      this.connect([{ id: step.step, kind }], ends.entries);
      exits.push(...ends.exits);
      top += height + this.gap.y;
    }
    return { entries: [step.step], exits };
  }

  /** What tasks wait for besides the order: by name, since a name stands for one task. */
  after(): void {
    const byName = new Map(this.nodes.flatMap((one) => (one.step.kind === 'task' ? [[one.step.name, one.id]] : [])));
    for (const { id, step } of this.nodes) {
      for (const name of step.kind === 'task' ? step.after : []) {
        const from = byName.get(name);
        if (from) this.connect([{ id: from, kind: 'after' }], [id]);
      }
    }
  }
}

/**
 * Where an edge passes other columns it turns in the gap before its end: its own row is free up to there, and the row of
 * its end may not be.
 */
function bent(edge: GraphEdge, nodes: ReadonlyMap<string, GraphNode>, gap: number): GraphEdge {
  const [from, to] = [nodes.get(edge.from), nodes.get(edge.to)];
  if (edge.kind !== 'order' || !from || !to) return edge;
  const way = to.x - from.x - from.width;
  return way > gap ? { ...edge, bend: 1 - gap / 2 / way } : edge;
}

/** Steps within others that a graph can show; more of them are a list. */
export const MOST_NODES = 500;

export function graphOf(outline: Outline, tasks: readonly TaskRow[], way: Way = 'right'): Graph {
  const layout = new Layout(tasks, way);
  const whole: Step = { step: '', line: 0, kind: 'sequence', steps: outline.steps };
  const size = layout.sizeOf(whole);
  layout.steps(outline.steps, 0, size.height / 2);
  layout.after();
  const nodes = new Map(layout.nodes.map((one) => [one.id, one]));
  const edges = layout.edges.map((one) => bent(one, nodes, GAPS[way].x));
  if (way === 'right') return { nodes: layout.nodes, edges, ...size };
  return { nodes: layout.nodes.map((one) => ({ ...turned(one), x: one.y, y: one.x })), edges, ...turned(size) };
}
