"""What strangers said, on its way to a person: on a terminal, in a log, in a table.

Names, subjects of certificates, texts of robots and of servers are chosen by whoever sends them. Among their characters
may be those that a terminal obeys (C0 and C1 controls), that end a line and forge the next one, or that turn the
direction of writing, so that a line reads otherwise than it is.
"""

from __future__ import annotations

import json
import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

__all__ = ["config_option", "harmless", "harmless_json", "harmless_lines", "utc_text"]


_OPTION: Final = [""]


def config_option(file: Path | None = None, default: Path | None = None) -> str:
    """What a command that is printed needs to be about this process's fleet: ` -c FILE`, or nothing.

    With a file, that is the fleet's from now on.
    """
    if file is not None:
        _OPTION[0] = "" if file == default else f" -c {shlex.quote(str(file))}"
    return _OPTION[0]


def harmless(text: str) -> str:
    r"""A text as one line that does nothing but be read.

    Each character that is not printable by Unicode (controls, line ends, marks of direction, what is not assigned, lone
    surrogates) is shown as its escape, e.g. `\n`, `\x9b`, `\u202e`.
    """
    if text.isprintable():
        return text
    return "".join([char if char.isprintable() else char.encode("unicode_escape").decode("ascii") for char in text])


def harmless_lines(text: str) -> str:
    """The same for what has several lines of our own making, such as a traceback: they stay lines."""
    return "\n".join(map(harmless, text.split("\n")))


def harmless_json(value: Any) -> str:
    """A value as JSON on one line; what is not printable is escaped as JSON does it (RFC 8259 section 7)."""
    text = json.dumps(value, ensure_ascii=False)
    if text.isprintable():
        return text
    return "".join([char if char.isprintable() else json.dumps(char)[1:-1] for char in text])


def utc_text(seconds: float) -> str:
    """A time of the wall clock, in seconds since 1970, to the second: `2030-01-31 12:00:00 UTC`."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
