"""How commands print: data on stdout, messages on stderr, and nothing that a terminal obeys on either."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from ua_fleet.cli.table import Cell, table_lines
from ua_fleet.printing import harmless, harmless_json

__all__ = ["message", "print_json", "print_line", "print_table", "write_line"]


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


def print_table(rows: Sequence[Sequence[Cell | str]], *, width: int | None = None, colours: bool = False) -> None:
    """Print rows with aligned columns; the first row is the heading."""
    for line in table_lines(rows, width=width, colours=colours):
        write_line(line)


def write_line(line: str) -> None:
    """Print a line at once whose parts have been made harmless, and may have colours."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
