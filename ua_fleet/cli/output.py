"""How commands print: data on stdout, messages on stderr, and nothing that a terminal obeys on either."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ua_fleet.printing import harmless, harmless_json

if TYPE_CHECKING:
    from ua_fleet.client import Reading

__all__ = ["message", "print_json", "print_line", "print_reading", "print_table"]


def message(text: str) -> None:
    """Tell the user something that is not data."""
    sys.stderr.write(harmless(text) + "\n")
    sys.stderr.flush()


def print_line(text: str) -> None:
    """Print a line of data at once."""
    sys.stdout.write(harmless(text) + "\n")
    sys.stdout.flush()


def print_json(value: Any) -> None:
    """Print one object on a line of its own, at once."""
    print_line(harmless_json(value))


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows with aligned columns; the first row is the heading."""
    rows = [[harmless(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print_line("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


def print_reading(address: str, reading: Reading, *, as_json: bool) -> None:
    """Print a node's value with its quality and time."""
    time = reading.source_time or reading.server_time
    if as_json:
        print_json(
            {
                "node": address,
                "node_id": reading.node_id,
                "value": reading.value,
                "type": reading.type_name,
                "status": reading.status_text,
                "source_time": reading.source_time.isoformat() if reading.source_time else None,
                "server_time": reading.server_time.isoformat() if reading.server_time else None,
            }
        )
        return
    value = "-" if reading.value is None else json.dumps(reading.value, ensure_ascii=False)
    quality = "" if reading.status == 0 else f"  {reading.status_text}"
    stamp = f"  {time.isoformat(timespec='milliseconds')}" if time else ""
    print_line(f"{address} = {value}{quality}{stamp}")
