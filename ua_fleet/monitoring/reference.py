"""The metrics as a table for docs/monitoring.md: `python -m ua_fleet.monitoring.reference` prints it."""

from __future__ import annotations

import sys

from ua_fleet.monitoring.metrics import METRICS, ProcessKind

__all__ = ["table"]


def table() -> str:
    """The metrics as a table in Markdown."""
    rows = ["| metric | kind | labels | who has it | |", "|---|---|---|---|---|"]
    for metric in METRICS:
        labels = ", ".join(f"`{label}`" for label in metric.labels)
        who = "all" if set(metric.processes) == set(ProcessKind) else ", ".join(metric.processes)
        rows.append(f"| `{metric.name}` | {metric.kind} | {labels} | {who} | {metric.help} |")
    return "\n".join(rows)


if __name__ == "__main__":
    sys.stdout.write(f"{table()}\n")
