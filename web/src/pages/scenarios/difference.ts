/** Two texts line by line: what both have, and what only one has. */
export interface DifferentLine {
  kind: 'same' | 'mine' | 'theirs';
  text: string;
}

/** Beyond this many cells the middle part is told as a whole, so that no text holds up the page. */
const MOST_CELLS = 4_000_000;

export function difference(mine: string, theirs: string): DifferentLine[] {
  const a = mine.split('\n');
  const b = theirs.split('\n');
  let head = 0;
  while (head < a.length && head < b.length && a[head] === b[head]) head += 1;
  let tail = 0;
  while (tail < a.length - head && tail < b.length - head && a[a.length - 1 - tail] === b[b.length - 1 - tail])
    tail += 1;
  const same = (lines: string[]) => lines.map((text): DifferentLine => ({ kind: 'same', text }));
  return [
    ...same(a.slice(0, head)),
    ...middle(a.slice(head, a.length - tail), b.slice(head, b.length - tail)),
    ...same(a.slice(a.length - tail)),
  ];
}

/** By the longest common subsequence. */
function middle(a: string[], b: string[]): DifferentLine[] {
  const mine = (text: string): DifferentLine => ({ kind: 'mine', text });
  const theirs = (text: string): DifferentLine => ({ kind: 'theirs', text });
  if (!a.length || !b.length || a.length * b.length > MOST_CELLS) return [...a.map(mine), ...b.map(theirs)];
  const width = b.length + 1;
  const longest = new Uint32Array((a.length + 1) * width);
  const at = (i: number, j: number) => longest[i * width + j] ?? 0;
  for (let i = a.length - 1; i >= 0; i -= 1) {
    for (let j = b.length - 1; j >= 0; j -= 1) {
      longest[i * width + j] = a[i] === b[j] ? at(i + 1, j + 1) + 1 : Math.max(at(i + 1, j), at(i, j + 1));
    }
  }
  const lines: DifferentLine[] = [];
  let i = 0;
  let j = 0;
  while (i < a.length && j < b.length) {
    if (a[i] === b[j]) {
      lines.push({ kind: 'same', text: a[i] ?? '' });
      i += 1;
      j += 1;
    } else if (at(i + 1, j) >= at(i, j + 1)) lines.push(mine(a[i++] ?? ''));
    else lines.push(theirs(b[j++] ?? ''));
  }
  return [...lines, ...a.slice(i).map(mine), ...b.slice(j).map(theirs)];
}

/** Only what differs, with so many lines around it; null stands for what is left out. */
export function around(lines: readonly DifferentLine[], context: number): (DifferentLine | null)[] {
  const kept = new Set<number>();
  lines.forEach((line, at) => {
    if (line.kind !== 'same') for (let near = at - context; near <= at + context; near += 1) kept.add(near);
  });
  const shown: (DifferentLine | null)[] = [];
  lines.forEach((line, at) => {
    if (kept.has(at)) shown.push(line);
    else if (shown.at(-1) !== null) shown.push(null);
  });
  return shown;
}
