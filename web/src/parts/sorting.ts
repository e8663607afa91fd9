/** Rows by what a column says of them; equal ones keep their order, and those it says nothing of are last. */
export type SortKey = string | number | null;

const collator = new Intl.Collator(undefined, { numeric: true, sensitivity: 'base' });

export function sorted<Row>(rows: readonly Row[], by: (row: Row) => SortKey, down: boolean): Row[] {
  const told = rows.map((row) => ({ row, key: by(row) }));
  const ranks = ranksOf(told.flatMap((one) => (typeof one.key === 'string' ? [one.key] : [])));
  const keyed = told.map(({ row, key }) => ({ row, key: typeof key === 'string' ? (ranks.get(key) ?? 0) : key }));
  keyed.sort((a, b) => {
    if (a.key === null || b.key === null) return Number(a.key === null) - Number(b.key === null);
    return down ? b.key - a.key : a.key - b.key;
  });
  return keyed.map((one) => one.row);
}

/** The places of texts in their order. Comparing as people do costs much, so each text is compared once. */
export function ranksOf(texts: Iterable<string>): Map<string, number> {
  const all = [...new Set(texts)].sort(collator.compare);
  // Those that only differ by case or accents are equal.
  const ranks = new Map<string, number>();
  let rank = 0;
  all.forEach((text, at) => {
    const before = all[at - 1];
    if (before !== undefined && collator.compare(before, text) !== 0) rank = at;
    ranks.set(text, rank);
  });
  return ranks;
}
