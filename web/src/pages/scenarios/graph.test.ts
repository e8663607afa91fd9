import { describe, expect, it } from 'vitest';
import { type Graph, type GraphNode, graphOf, NODE, type Way } from './graph';
import type { Outline, Step, TaskRow } from './types';

const task = (step: string, name: string, after: string[] = []): Step => ({
  ...{ step, line: 1, kind: 'task', name, skill: 'work', robot: null, capacities: [], after },
});
const wait = (step: string): Step => ({
  ...{ step, line: 1, kind: 'wait', for_s: 1, until: null, event: null, timeout_s: null },
});
const of = (steps: Step[], tasks: TaskRow[] = [], way: Way = 'right') => {
  const outline: Outline = { name: 'a', description: '', parameters: [], steps, problems: [] };
  return graphOf(outline, tasks, way);
};
const row = (step: string, state: TaskRow['state']): TaskRow => ({
  ...{ step, task: 'x', robot: 'left', skill: 'work', state, attempt: 1, result: {}, message: '' },
});
const edges = (graph: Graph) => graph.edges.map((one) => `${one.from} ${one.kind} ${one.to}`);
const at = (graph: Graph, id: string) => graph.nodes.find((one) => one.id === id);

const ALL: Step[] = [
  task('0', 'one'),
  {
    ...{ step: '1', line: 1, kind: 'parallel' },
    steps: [
      { step: '1.0', line: 1, kind: 'sequence', steps: [task('1.0.0', 'two'), wait('1.0.1')] },
      { step: '1.1', line: 1, kind: 'sequence', steps: [task('1.1.0', 'three', ['two', 'nobody'])] },
    ],
  },
  { step: '2', line: 1, kind: 'if', when: 'x', then: [task('2.then.0', 'four')], else: [] },
  { step: '3', line: 1, kind: 'repeat', times: 2, while: null, steps: [task('3.repeat.0', 'five')] },
  {
    ...{ step: '4', line: 1, kind: 'if', when: 'y' },
    then: [{ step: '4.then.0', line: 1, kind: 'end', outcome: 'failed', reason: '' }],
    else: [wait('4.else.0')],
  },
  task('5', 'six'),
];

describe('graphOf', () => {
  it('has an edge that passes another branch turn at its end, and not behind a step', () => {
    const graph = of([
      {
        ...{ step: '0', line: 1, kind: 'parallel' },
        steps: [
          task('0.0', 'short'),
          {
            step: '0.1',
            line: 1,
            kind: 'sequence',
            steps: [task('0.1.0', 'a'), task('0.1.1', 'b'), task('0.1.2', 'c')],
          },
        ],
      },
    ]);
    const edge = graph.edges.find((one) => one.from === '0.0');
    const [from, to, last] = ['0.0', '0 join', '0.1.2'].map((id) => at(graph, id));
    if (!edge?.bend || !from || !to || !last) throw new Error('no such edge');
    const start = from.x + from.width;
    expect(start + edge.bend * (to.x - start)).toBeGreaterThan(last.x + last.width);
    expect(graph.edges.find((one) => one.from === '0.1.0')?.bend).toBeUndefined();
  });

  it('has what follows what, and what waits for what', () => {
    expect(edges(of(ALL))).toEqual([
      '1.0.0 order 1.0.1',
      '1 fork order 1.0.0',
      '1.0.1 order 1 join',
      '1 fork order 1.1.0',
      '1.1.0 order 1 join',
      '0 order 1 fork',
      '2 then 2.then.0',
      '1 join order 2',
      '3 order 3.repeat.0',
      '3.repeat.0 back 3',
      '2.then.0 order 3',
      '2 else 3',
      '4 then 4.then.0',
      '4 else 4.else.0',
      '3.repeat.0 order 4',
      '4.else.0 order 5',
      '1.0.0 after 1.1.0',
    ]);
  });
  it.each(['right', 'down'] as const)('goes %s, with nothing over anything else, and within its size', (way) => {
    const graph = of(ALL, [], way);
    const end = (one?: GraphNode) =>
      way === 'right' ? (one?.x ?? 0) + (one?.width ?? 0) : (one?.y ?? 0) + (one?.height ?? 0);
    const start = (one?: GraphNode) => (way === 'right' ? one?.x : one?.y) ?? 0;
    const { nodes } = graph;
    for (const one of nodes) {
      expect([one.x >= 0, one.y >= 0]).toEqual([true, true]);
      expect([one.x + one.width <= graph.width, one.y + one.height <= graph.height]).toEqual([true, true]);
      for (const other of nodes) {
        if (other === one) continue;
        const apart =
          one.x + one.width <= other.x ||
          other.x + other.width <= one.x ||
          one.y + one.height <= other.y ||
          other.y + other.height <= one.y;
        expect([one.id, other.id, apart]).toEqual([one.id, other.id, true]);
      }
    }
    for (const edge of graph.edges.filter((one) => one.kind !== 'back' && one.kind !== 'after')) {
      const [from, to] = [at(graph, edge.from), at(graph, edge.to)];
      expect(end(from)).toBeLessThan(start(to));
    }
  });
  it('goes down with steps of the same size, and the same edges', () => {
    const [right, down] = [of(ALL), of(ALL, [], 'down')];
    expect(edges(down)).toEqual(edges(right));
    expect(at(down, '0')).toMatchObject({ ...NODE, y: 0 });
    expect(down.width).toBeLessThan(right.width / 3);
  });
  it('has the last repetition that a task has come to', () => {
    const graph = of(ALL, [row('3.repeat.0@0', 'done'), row('3.repeat.0@1', 'accepted')]);
    expect(at(graph, '3.repeat.0')).toMatchObject({ times: 2, task: { state: 'accepted' } });
    expect(at(graph, '0')).toMatchObject({ times: 0, task: null, ...NODE });
  });
  it('is of a scenario without steps, and of a long one, too', () => {
    expect(of([])).toEqual({ nodes: [], edges: [], width: 0, height: 0 });
    const many = of(Array.from({ length: 2000 }, (_, number) => wait(String(number))));
    expect([many.nodes.length, many.edges.length]).toEqual([2000, 1999]);
  });
});
