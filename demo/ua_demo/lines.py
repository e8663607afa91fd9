"""What robots' programs say on stdout: one JSON object a line, see `report.py`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["LineEvent", "read_line"]


@dataclass(frozen=True, slots=True)
class LineEvent:
    """One fact. `t` is seconds since 1970, `what` as in the robots' programs."""

    t: float
    who: str
    what: str
    details: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def text(self) -> str:
        """The event for people."""
        shown = {k: v for k, v in self.details.items() if k != "delay_ms"}
        suffix = ", ".join(f"{key} {_word(value)}" for key, value in shown.items())
        return f"{self.who} {self.what}" + (f" ({suffix})" if suffix else "")


def read_line(line: str) -> LineEvent | None:
    """The event of a line; None for a library's own message, which stands in the log."""
    try:
        said = json.loads(line)
        return LineEvent(float(said.pop("t")), str(said.pop("who")), str(said.pop("what")), said)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None


def _word(value: object) -> str:
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value)
