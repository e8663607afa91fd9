"""Put the results into docs/benchmarks.md: `python -m benchmarks.report`.

It takes `results.json`, the rows of the last runs, and replaces what stands between the page's two markers.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.harness import Figure
from ua_fleet.config.reference import put_between

HERE = Path(__file__).parent
RESULTS = HERE / "results.json"
PAGE = HERE.parent / "docs" / "benchmarks.md"
BEGIN, END = "<!-- results -->", "<!-- end of the results -->"


def table(figures: list[Figure]) -> str:
    rows = ["| figure | value | reference | ratio | goal | holds |", "|---|---|---|---|---|---|"]
    for figure in figures:
        goal = "" if figure.goal is None else f"{figure.goal:g}"
        reference = f"{figure.reference_value:.4g} {figure.unit} ({figure.reference})"
        holds = "yes" if figure.holds else "**no**"
        value = f"{figure.value:.4g} {figure.unit}"
        rows.append(f"| {figure.name} | {value} | {reference} | {figure.ratio:.2f} | {goal} | {holds} |")
    return "\n".join(rows)


def main() -> int:
    if not RESULTS.exists():
        print("there are no results; run: make bench", file=sys.stderr)
        return 1
    rows: list[dict[str, Any]] = json.loads(RESULTS.read_text(encoding="utf-8"))
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(put_between(page, BEGIN, END, table([Figure(**row) for row in rows])), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
