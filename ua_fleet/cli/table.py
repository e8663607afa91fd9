"""Tables of text for terminals: columns in line, colours, and nothing wider than the terminal. Pure."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence
from enum import StrEnum
from typing import Final, NamedTuple

from ua_fleet.printing import harmless

__all__ = ["Cell", "Colour", "painted", "table_lines", "width_of", "within"]

_BETWEEN: Final = "  "
_RESET: Final = "\x1b[0m"
_LEAST: Final = 8
"""Cells that a column keeps when the table is too wide."""


class Colour(StrEnum):
    """Meanings, as ANSI attributes that each terminal has."""

    GOOD = "\x1b[32m"
    WARNING = "\x1b[33m"
    BAD = "\x1b[31m"
    HEAD = "\x1b[1m"
    FAINT = "\x1b[2m"


class Cell(NamedTuple):
    """A text in a table."""

    text: str
    colour: Colour | None = None
    keeps_end: bool = False
    """Whether its beginning is cut where it is too long, and not its end."""


def painted(text: str, colour: Colour | None, *, colours: bool) -> str:
    """A text in a colour, where there are colours; what a terminal would obey in it is made harmless first."""
    shown = harmless(text)
    return f"{colour}{shown}{_RESET}" if colours and colour is not None and shown else shown


def width_of(text: str) -> int:
    """Cells of a terminal that a text takes."""
    if text.isascii():
        return len(text)
    return sum(0 if unicodedata.combining(one) else 1 + (unicodedata.east_asian_width(one) in "WF") for one in text)


def within(text: str, width: int, *, keeps_end: bool = False) -> str:
    """A text that takes no more cells than that; `…` stands for what is cut, at its end or at its beginning."""
    if keeps_end:
        return within(text[::-1], width)[::-1]
    if width_of(text) <= width:
        return text
    taken, used = "", 0
    for one in text:
        used += width_of(one)
        if used > width - 1:
            break
        taken += one
    return f"{taken}…" if width > 0 else ""


def table_lines(
    rows: Sequence[Sequence[Cell | str]], *, width: int | None = None, colours: bool = False, indent: str = ""
) -> list[str]:
    """The rows of a table as lines.

    Args:
        rows: all of the same length.
        width: cells that a line may take; the widest columns are cut then. None is any number.
        colours: whether the cells' colours are shown.
        indent: what each line begins with.
    """
    cells = [[one if isinstance(one, Cell) else Cell(one) for one in row] for row in rows]
    shown = [[harmless(cell.text) for cell in row] for row in cells]
    if not shown:
        return []
    widths = [max(map(width_of, column)) for column in zip(*shown, strict=True)]
    if width is not None:
        _narrow(widths, width - len(indent) - len(_BETWEEN) * (len(widths) - 1))
    lines: list[str] = []
    for row, texts in zip(cells, shown, strict=True):
        line = indent
        for place, (cell, text, size) in enumerate(zip(row, texts, widths, strict=True)):
            cut = within(text, size, keeps_end=cell.keeps_end)
            room = " " * (size - width_of(cut))
            is_last = not any(texts[place + 1 :])
            line += painted(cut, cell.colour, colours=colours) + ("" if is_last else room + _BETWEEN)
            if is_last:
                break
        lines.append(line.rstrip())
    return lines


def _narrow(widths: list[int], room: int) -> None:
    """Make the widest columns smaller until all fit, as far as that goes."""
    while sum(widths) > room:
        widest = max(range(len(widths)), key=widths.__getitem__)
        if widths[widest] <= _LEAST:
            return
        others = sorted(widths)
        least = others[-2] if len(others) > 1 and others[-2] < widths[widest] else widths[widest] - 1
        widths[widest] = max(least, _LEAST, widths[widest] - (sum(widths) - room))
