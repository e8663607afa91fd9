"""Asks the dashboard server whether the robot is in remote control. Nothing waits for it; for one thread.

The question has a child of its own: a dashboard server that does not answer would hold up the child that commands, and
with it the halt of a move.
"""

from __future__ import annotations

from typing import Any, Final

import structlog

from ua_bridges.ur.library.child import ChildFailed, LibraryChild, NoAnswer

__all__ = ["RemoteControl"]

_PERIOD_S: Final = 1.0
_LONGEST_PAUSE_S: Final = 30.0
_START_S: Final = 5.0
"""Python and the library are there within this."""

_log = structlog.get_logger(__name__)


class RemoteControl:
    """See the module."""

    def __init__(self, host: str, timeout_s: float) -> None:
        self._host, self._timeout_s = host, timeout_s
        self._child: LibraryChild | None = None
        self._answer_by: float | None = None
        """Until when an answer is waited for; None: none is."""
        self._ask_at, self._pause_s = 0.0, _PERIOD_S

    def look(self, now: float) -> bool | None:
        """What was answered since the last look, None where nothing was; asks again where that is due."""
        try:
            if self._answer_by is None:
                if now >= self._ask_at:
                    self._ask(now)
                return None
            assert self._child is not None
            answer: dict[str, Any] = self._child.line(0.0)
            if "error" in answer:
                raise ChildFailed(" ".join(str(answer["error"]).split()))
        except NoAnswer:
            if self._answer_by is not None and now >= self._answer_by:
                self._put_off(now, "no answer in time")
            return None
        except ChildFailed as error:
            self._put_off(now, str(error))
            return None
        self._answer_by, self._ask_at, self._pause_s = None, now + _PERIOD_S, _PERIOD_S
        return bool(answer["result"])

    def _ask(self, now: float) -> None:
        self._answer_by = now + self._timeout_s
        if self._child is None:
            self._child = LibraryChild("commanding", self._host)
            self._answer_by += _START_S
        self._child.say({"on": "dashboard", "call": "isInRemoteControl", "args": []})

    def _put_off(self, now: float, reason: str) -> None:
        """Ask anew later, and over a new connection: an answer that is late belongs to no other question."""
        _log.debug("the dashboard server does not answer", controller=self._host, reason=reason)
        pause_s = self._pause_s
        self.close()
        self._ask_at, self._pause_s = now + pause_s, min(pause_s * 2, _LONGEST_PAUSE_S)

    def close(self) -> None:
        """End the child; the next look asks anew."""
        child, self._child, self._answer_by = self._child, None, None
        self._ask_at, self._pause_s = 0.0, _PERIOD_S
        if child is not None:
            child.end()
