/** Which rows of a long list are drawn: those that can be seen, and some around them. */
export interface Window {
  first: number;
  /** Of the row after the last one. */
  end: number;
}

const SPARE = 8;
/** Of lines that may be high. */
const LINES = 3;

/** @param columns how many stand beside each other */
export function windowOf(count: number, rowHeight: number, scrollTop: number, height: number, columns = 1): Window {
  const rows = Math.ceil(count / columns);
  const first = Math.max(0, Math.min(rows, Math.floor(scrollTop / rowHeight)) - SPARE);
  const end = Math.min(rows, Math.ceil((scrollTop + height) / rowHeight) + SPARE);
  return { first: first * columns, end: Math.min(count, end * columns) };
}

/** The same for lines of different heights; `tops` has the top of each, and the end of the last one. */
export function linesOf(tops: readonly number[], scrollTop: number, height: number): Window {
  const count = tops.length - 1;
  /** The first line whose top is beyond. */
  const beyond = (at: number) => {
    let [low, high] = [0, count];
    while (low < high) {
      const middle = (low + high) >> 1;
      if ((tops[middle] ?? 0) > at) high = middle;
      else low = middle + 1;
    }
    return low;
  };
  const first = Math.max(0, beyond(scrollTop) - 1 - LINES);
  return { first, end: Math.max(first, Math.min(count, beyond(scrollTop + height) + LINES)) };
}
