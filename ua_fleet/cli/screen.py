"""The terminal: whether there is one, its size and its colours, and a picture that is drawn again and again."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from typing import Annotated, Final, TextIO, cast

import typer

__all__ = ["ColorOption", "ColorWhen", "Screen", "columns_of", "has_colours", "live_screen", "terminal_width"]

_ALTERNATE: Final = "\x1b[?1049h\x1b[?25l\x1b[?7l"
"""The other screen, without a cursor, and with lines that are cut where they are too wide."""
_NORMAL: Final = "\x1b[?7h\x1b[?25h\x1b[?1049l"
_HOME: Final = "\x1b[H"
_REST_OF_LINE: Final = "\x1b[K"
_REST_OF_SCREEN: Final = "\x1b[J"


class ColorWhen(StrEnum):
    """When to use colours."""

    AUTO = "auto"
    ALWAYS = "always"
    NEVER = "never"


ColorOption = Annotated[
    ColorWhen,
    typer.Option(
        "--color", help="Colours: with auto only on a terminal, and only if NO_COLOR is not set (no-color.org)."
    ),
]


def has_colours(when: ColorWhen, stream: TextIO | None = None) -> bool:
    """Whether to print colours on a stream, by default stdout."""
    if when is not ColorWhen.AUTO:
        return when is ColorWhen.ALWAYS
    stream = stream or cast("TextIO", sys.stdout)
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def terminal_width() -> int | None:
    """Cells of a line, where stdout is a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def columns_of(stream: TextIO) -> int:
    """Cells of a line of the terminal that a stream is; COLUMNS goes before, and 80 are where neither says it."""
    try:
        known = os.get_terminal_size(stream.fileno())
    except (OSError, ValueError):
        known = os.terminal_size((80, 24))
    given = os.environ.get("COLUMNS", "")
    return int(given) if given.isdecimal() and int(given) else known.columns or 80


class Screen:
    """What is shown now. On a terminal each picture takes the place of the one before; else they follow each other."""

    def __init__(self, *, is_live: bool) -> None:
        self._is_live = is_live
        self._last: Sequence[str] = ()

    def show(self, lines: Sequence[str]) -> None:
        """Show a picture; its lines have been made harmless."""
        self._last = lines
        if not self._is_live:
            sys.stdout.write("".join(f"{line}\n" for line in (*lines, "")))
            sys.stdout.flush()
            return
        height = shutil.get_terminal_size().lines
        if len(lines) > height:
            left_out = len(lines) - height + 1
            lines = [
                *lines[: height - 1],
                f"… {left_out} more lines: make the window larger, or end this",
            ]
        sys.stdout.write(_HOME + f"{_REST_OF_LINE}\r\n".join(lines) + _REST_OF_LINE + _REST_OF_SCREEN)
        sys.stdout.flush()

    def end(self) -> None:
        """Give the terminal back, with the last picture in it."""
        if self._is_live:
            sys.stdout.write(_NORMAL + "".join(f"{line}\n" for line in self._last))
            sys.stdout.flush()

    def begin(self) -> None:
        """Take the terminal."""
        if self._is_live:
            sys.stdout.write(_ALTERNATE)
            sys.stdout.flush()


@contextmanager
def live_screen() -> Generator[Screen]:
    """A screen, as long as the context lasts."""
    screen = Screen(is_live=sys.stdout.isatty() and os.environ.get("TERM") != "dumb")
    screen.begin()
    try:
        yield screen
    finally:
        screen.end()
