"""The executions that a bridge's driver has under way: each ends once, whatever the robot says later. Pure.

    (none)    begin                          open
    open      progress                       ExecutionProgressed, where it is new
    open      suspended                      ExecutionSuspended; suspended
    suspended progress                       ExecutionResumed, and as above; open
    open      end, forget                    ExecutionEnded, ExecutionForgotten; ended
    open      told_to_stop                   HALTED_S to say that the robot stands, or how it has ended; then forget
    open      never                          ExecutionNotBegun; as if it had not been there
    ended     an answer                      counted: the robot said it twice, or too late
    (none)    an answer                      counted: it belongs to another execution

All calls come from one thread, the one in which the driver hears its robots.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
)
from ua_fleet.counters import Drop
from ua_fleet.values import StatusCode

__all__ = ["HALTED_S", "Ended", "Executing", "Open", "ended_text", "halted"]

HALTED_S: Final = 5.0
"""So long a robot that was told to stop may take to say that it stands; then nobody knows. A run waits for 10 s."""
NOT_SEEN_TO_STAND: Final = "it was told to stop, and its standstill is not confirmed; see what the robot does"

_MOST_REMEMBERED: Final = 1000
_MOST_TEXT: Final = 200
_LEAST_STEP: Final = 0.01
"""Progress that differs by less is not told."""


class Ended(NamedTuple):
    """How a robot ended an execution: as in ExecutionEnded."""

    status: int
    values: tuple[Any, ...] = ()
    message: str = ""


def ended_text(text: str) -> str:
    """A robot's text as one line of bounded length."""
    line = " ".join(text.split())
    return line if len(line) <= _MOST_TEXT else f"{line[: _MOST_TEXT - 3]}..."


def halted(said: str = "") -> Ended:
    """The end of what has stopped because it was told to: somebody has seen that it stands, or it was never told."""
    return Ended(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), said or "it was halted")


class Open:
    """One execution under way."""

    __slots__ = (
        *("_timeout_s", "arguments", "deadline", "execution_id", "is_suspended", "is_told_to_stop"),
        *("said", "skill", "told"),
    )

    def __init__(self, spec: ConfiguredSkill[Any], execution: Execution, deadline: float) -> None:
        self.skill = f"{spec.robot}.{spec.name}"
        self.execution_id = execution.execution_id
        self.arguments: Mapping[str, Any] = dict(zip(spec.arguments, execution.values, strict=True))
        self.deadline = deadline
        self._timeout_s = spec.config.timeout_s
        self.told: float | None = None
        """The progress that was told last."""
        self.said = ""
        """What the robot said with it."""
        self.is_suspended = False
        """Whether the robot stands in the middle of it."""
        self.is_told_to_stop = False
        """Whether it is over when the robot says that it stands. What is overdue then is forgotten."""

    def too_long(self, *, is_halted: bool, otherwise: str = "see what the robot does") -> Ended:
        """How it ends when its time is over.

        Args:
            is_halted: whether the robot was told to stop.
            otherwise: what people are to know where it was not.
        """
        what_then = "it was told to stop" if is_halted else otherwise
        return Ended(StatusCode.BAD_TIMEOUT, (), f"it took longer than {self._timeout_s:g} s; {what_then}")


class Executing:
    """The executions of one driver."""

    def __init__(self, put: Callable[[DriverEvent], None]) -> None:
        self._put = put
        self._open: dict[bytes, Open] = {}
        self._ended: dict[bytes, None] = {}

    def begin(self, spec: ConfiguredSkill[Any], execution: Execution, now: float) -> Open:
        """An execution is begun, or asked about; its time begins."""
        opened = Open(spec, execution, now + spec.config.timeout_s)
        self._ended.pop(execution.execution_id, None)
        self._open[execution.execution_id] = opened
        return opened

    def get(self, execution_id: bytes) -> Open | None:
        """An execution that is under way."""
        return self._open.get(execution_id)

    def progress(self, execution_id: bytes, fraction: float, said: str = "") -> None:
        """The robot is at it. The first time is always told."""
        opened = self._open.get(execution_id)
        if opened is None:
            self.unasked(execution_id)
            return
        if opened.is_suspended:
            opened.is_suspended, opened.told = False, None
            self._put(ExecutionResumed(execution_id))
        self._tell(opened, fraction, said)

    def suspended(self, execution_id: bytes, fraction: float, said: str = "") -> None:
        """The robot stands in the middle of it, so far."""
        opened = self._open.get(execution_id)
        if opened is None:
            self.unasked(execution_id)
            return
        if not opened.is_suspended:
            opened.is_suspended, opened.told = True, None
            self._put(ExecutionSuspended(execution_id, said))
        self._tell(opened, fraction, said)

    def _tell(self, opened: Open, fraction: float, said: str) -> None:
        if opened.told is not None and abs(opened.told - fraction) < _LEAST_STEP and opened.said == said:
            return
        opened.told, opened.said = fraction, said
        self._put(ExecutionProgressed(opened.execution_id, fraction, said))

    def told_to_stop(self, execution_id: bytes, now: float) -> None:
        """The robot was told to stop, which does not say that it has. Told again, its time does not begin anew."""
        opened = self._open.get(execution_id)
        if opened is not None and not opened.is_told_to_stop:
            opened.is_told_to_stop, opened.deadline = True, now + HALTED_S

    def end(self, execution_id: bytes, ended: Ended) -> bool:
        """It is over; False, and counted, where it was not under way."""
        if not self._close(execution_id):
            return False
        self._put(ExecutionEnded(execution_id, ended.status, ended.values, ended.message))
        return True

    def forget(self, execution_id: bytes, why: str = NOT_SEEN_TO_STAND) -> None:
        """Nobody can tell what became of it. `why` may be left out for what was told to stop."""
        if self._close(execution_id):
            self._put(ExecutionForgotten(execution_id, why))

    def never(self, execution_id: bytes) -> None:
        """The robot knows for sure that it never heard of it; ExecutionNotBegun is said."""
        if self._open.pop(execution_id, None) is None:
            self.unasked(execution_id)
        else:
            self._put(ExecutionNotBegun(execution_id))

    def due(self) -> float | None:
        """When the next one has taken too long, None where none is under way."""
        return min((opened.deadline for opened in self._open.values()), default=None)

    def overdue(self, now: float) -> list[Open]:
        """Those that have taken longer than their skill's timeout."""
        return [opened for opened in self._open.values() if now >= opened.deadline]

    def _close(self, execution_id: bytes) -> bool:
        if self._open.pop(execution_id, None) is None:
            self.unasked(execution_id)
            return False
        self._ended[execution_id] = None
        if len(self._ended) > _MOST_REMEMBERED:
            del self._ended[next(iter(self._ended))]
        return True

    def unasked(self, execution_id: bytes, name: str = "") -> None:
        """The robot has answered what nobody waits for."""
        where = f"{name}: " if name else ""
        if execution_id in self._ended:
            self._put(Dropped(Drop.UNASKED, detail=f"{where}a robot answered again, or after its time was over"))
        else:
            self._put(Dropped(Drop.UNASKED, detail=f"{where}a robot answered for an execution that is not open"))
