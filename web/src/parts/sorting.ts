/** Rows by what a column says of them; equal ones keep their order, and those it says nothing of are last. */
export type SortKey = string | number | null;

const collator = new Intl.Collator(undefined, { numeric: true, sensitivity: 'base' });

export function compared(a: SortKey, b: SortKey): number {
  return typeof a === 'number' && typeof b === 'number' ? a - b : collator.compare(String(a), String(b));
}

export function sorted<Row>(rows: readonly Row[], by: (row: Row) => SortKey, down: boolean): Row[] {
  const keyed = rows.map((row) => ({ row, key: by(row) }));
  keyed.sort((a, b) => {
    if (a.key === null || b.key === null) return Number(a.key === null) - Number(b.key === null);
    return down ? compared(b.key, a.key) : compared(a.key, b.key);
  });
  return keyed.map((one) => one.row);
}
