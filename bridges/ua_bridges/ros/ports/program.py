"""A skill that a robot's own program offers, by JSON on two topics (see `ua_bridges.ros.skill_json`).

A request is sent once: a program that has been restarted would not know that it has done it. Where no answer comes, the
program is asked; where it does not know the execution, nobody can tell.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

from ua_bridges.ros.ports.port import Listened, SkillGraph, SkillPort
from ua_bridges.ros.skill_json import (
    ProgramState,
    StatusInvalid,
    cancel_text,
    ended_of,
    execute_text,
    parse_status,
    query_text,
    resume_text,
    suspend_text,
)
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros.topic_mapping import QosConfig
from ua_fleet.bridge.driver import DriverEvent, Dropped, Execution
from ua_fleet.bridge.executing import Executing, Open
from ua_fleet.counters import Drop
from ua_fleet.errors import SkillRejected

__all__ = ["ProgramPort"]

ANSWER_S: Final = 2.0
"""A program answers a request at once; it is asked after so long."""
ASK_AGAIN_S: Final = 5.0
"""A program that was silent for so long is asked: it may have been restarted, or a message lost."""

_TEXT: Final = "std_msgs/String"
_QOS: Final = QosConfig(depth=100)
_ENDS: Final = (ProgramState.REFUSED, ProgramState.DONE, ProgramState.FAILED, ProgramState.HALTED)


class ProgramPort(SkillPort[SkillGraph]):
    """See the module."""

    def __init__(self, spec: SkillSpec, executing: Executing, put: Callable[[DriverEvent], None]) -> None:
        super().__init__(spec, executing, put)
        self._status_name = f"/{spec.status_topic}"
        self._no_program = f"no program offers the skill ({self._status_name} has no publisher); start the robot's"
        self._source = self._no_program
        self.cannot_suspend = ""
        self._ask_at: dict[bytes, float] = {}
        """When each open execution is asked about, unless the program says something of it before."""

    def _open(self, graph: SkillGraph) -> None:
        self._class = graph.load(_TEXT).cls
        self._spoken = graph.speak(f"/{self.spec.request_topic}", _TEXT, _QOS)

    def listened(self) -> tuple[Listened, ...]:
        """See SkillPort."""
        return (Listened(self._status_name, _TEXT, _QOS, self._heard, self._source_changed),)

    def _source_changed(self, problem: str) -> None:
        """A program that comes back is asked at once."""
        if self._source and not problem:
            self._ask_at = dict.fromkeys(self._ask_at, 0.0)
        self._source = self._no_program if problem else ""

    def _request_of(self, execution: Execution) -> Any:
        spec = self.spec
        arguments = dict(zip(spec.arguments, execution.values, strict=True))
        try:
            return self._class(data=execute_text(execution.execution_id, spec.name, arguments, spec.config.timeout_s))
        except ValueError as error:
            raise SkillRejected(f"the arguments cannot be written as JSON: {error}") from error

    def _look(self, now: float) -> str:
        return self._source or self._spoken.look(now)

    def _tell(self, execution_id: bytes, request: Any, now: float) -> None:
        self._spoken.publish(request)
        self._ask_at[execution_id] = now + ANSWER_S

    def _ask(self, execution_id: bytes, now: float) -> None:
        self._ask_at[execution_id] = now

    def _heard(self, message: Any) -> None:
        try:
            status = parse_status(message.data)
        except StatusInvalid as error:
            self._put(Dropped(Drop.MALFORMED, detail=f"{self._status_name}: {error}"))
            return
        execution_id = status.execution_id
        opened = self._executing.get(execution_id)
        if opened is None or opened.skill != f"{self.spec.robot}.{self.spec.name}":
            if status.state is not ProgramState.UNKNOWN:
                self._executing.unasked(execution_id, self._status_name)
        elif status.state is ProgramState.UNKNOWN:
            self._executing.forget(execution_id, status.message or "the robot's program remembers nothing of it")
        elif status.state in _ENDS:
            self._executing.end(execution_id, ended_of(status, self.spec.config))
        else:
            is_suspended = status.state is ProgramState.SUSPENDED
            tell = self._executing.suspended if is_suspended else self._executing.progress
            tell(execution_id, status.progress, status.message)
            self._ask_at[execution_id] = time.monotonic() + ASK_AGAIN_S

    def turn(self, now: float) -> None:
        """See SkillPort."""
        super().turn(now)
        for execution_id, ask_at in list(self._ask_at.items()):
            if self._executing.get(execution_id) is None:
                del self._ask_at[execution_id]
            elif now >= ask_at and not self.absent:
                self._spoken.publish(self._class(data=query_text(execution_id)))
                self._ask_at[execution_id] = now + ANSWER_S

    def _cannot_be_told(self, now: float) -> str:
        """It hears before it has said anything."""
        return self._spoken.look(now)

    def _stop(self, execution_id: bytes, now: float) -> None:
        self._spoken.publish(self._class(data=cancel_text(execution_id)))

    def suspend(self, execution_id: bytes) -> None:
        """See SkillPort."""
        self._spoken.publish(self._class(data=suspend_text(execution_id)))

    def resume(self, execution_id: bytes) -> None:
        """See SkillPort."""
        self._spoken.publish(self._class(data=resume_text(execution_id)))

    def _give_up(self, opened: Open, now: float) -> None:
        """The program is asked to stop; of one that never answered nobody knows what it did."""
        untold = self._have_stopped(opened.execution_id, now)
        if opened.told is None:
            self._executing.forget(opened.execution_id, "the robot's program never answered; see what the robot does")
        else:
            self._executing.end(
                opened.execution_id, opened.too_long(is_halted=not untold, otherwise=self._untold(untold))
            )
