/** Which rows of a long list are drawn: those that can be seen, and some around them. */
export interface Window {
  first: number;
  /** Of the row after the last one. */
  end: number;
}

const SPARE = 8;

/** @param columns how many stand beside each other */
export function windowOf(count: number, rowHeight: number, scrollTop: number, height: number, columns = 1): Window {
  const rows = Math.ceil(count / columns);
  const first = Math.max(0, Math.min(rows, Math.floor(scrollTop / rowHeight)) - SPARE);
  const end = Math.min(rows, Math.ceil((scrollTop + height) / rowHeight) + SPARE);
  return { first: first * columns, end: Math.min(count, end * columns) };
}
