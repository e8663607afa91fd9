"""How an execution of a skill goes on, for the person who waits for it: pure, but for `ProgressLine`."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from typing import TextIO, cast

from ua_fleet.cli.screen import columns_of
from ua_fleet.cli.table import within
from ua_fleet.cli.value_text import duration_text
from ua_fleet.printing import harmless

__all__ = ["ProgressLine", "SkillProgress", "progress_text"]

_BAR: int = 20
_ERASED = "\r\x1b[K"


@dataclass(slots=True)
class SkillProgress:
    """What is known of an execution."""

    robot: str
    skill: str
    execution_id: str
    timeout_s: float
    state: str = "Running"
    progress: float | None = None
    """0 to 1; None where the robot says nothing."""
    message: str = ""
    latest_id: str | None = None
    """The execution that the skill's nodes tell of: another one may have been begun after this one."""

    def take(self, member: str, value: object) -> bool:
        """A Variable of the skill has a value; whether that says something new of this execution."""
        if member == "ExecutionId":
            self.latest_id = value if isinstance(value, str) else None
            return False
        if self.latest_id != self.execution_id:
            return False
        before = (self.state, self.progress, self.message)
        if member == "CurrentState" and isinstance(value, str):
            self.state = value
        elif member == "Progress":
            self.progress = min(1.0, max(0.0, float(value))) if isinstance(value, int | float) else None
        elif member == "Message":
            self.message = value if isinstance(value, str) else ""
        return before != (self.state, self.progress, self.message)


def progress_text(known: SkillProgress, elapsed_s: float, *, with_bar: bool) -> str:
    """One line: the skill, its state, how far it is, what the robot says, and since when."""
    parts = [f"{known.robot}.{known.skill}", known.state]
    if known.progress is not None:
        if with_bar:
            done = round(known.progress * _BAR)
            parts.append(f"[{'#' * done}{'.' * (_BAR - done)}]")
        parts.append(f"{known.progress:.0%}")
    parts.append(f"{duration_text(elapsed_s)} of at most {duration_text(known.timeout_s)}")
    if known.message:
        parts.append(known.message)
    return "  ".join(parts)


class ProgressLine:
    """A line on stderr that is written over again and again, where that is a terminal; else a line for each change."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or cast("TextIO", sys.stderr)
        self.is_live = self._stream.isatty() and os.environ.get("TERM") != "dumb"
        self._is_drawn = False

    def show(self, text: str, *, is_change: bool) -> None:
        """Show how it stands; without a terminal only what has changed."""
        text = harmless(text)
        if self.is_live:
            self._stream.write(_ERASED + within(text, columns_of(self._stream) - 1))
            self._is_drawn = True
        elif is_change:
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Take the line away, so that others can be written."""
        if self._is_drawn:
            self._stream.write(_ERASED)
            self._stream.flush()
            self._is_drawn = False
