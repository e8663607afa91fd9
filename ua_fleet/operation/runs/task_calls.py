"""What is asked of a robot for a task, and what asks it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Final, Protocol

from ua_fleet.fleet.model import RobotModel
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator import TaskStarted
from ua_fleet.scenario import Value
from ua_fleet.skill.executions import RequestOutcome
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

__all__ = ["START_WITHIN_S", "Recorded", "Requests", "call_of"]

START_WITHIN_S: Final = 10.0
"""A robot that has not begun by then has refused. Immediate skills have their own timeout: they answer at their end."""
_FLOATS: Final = (BuiltinType.FLOAT, BuiltinType.DOUBLE)

Recorded = RecordedRequest | RecordedExecution
"""The record of a request: to a robot's bridge, or to clients."""


class Requests(Protocol):
    """What asks robots; see `server.commands_out.SkillCommands`."""

    def request(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> None:
        """Have a robot do a skill, once, and wait for nothing."""
        ...

    def prepare(
        self, topic: Topic, robot: str, skill: str, arguments: Mapping[str, Any], timeout_s: float, execution_id: bytes
    ) -> Recorded | None:
        """The record of a request, to be written down with what it follows from; None where it is not prepared."""
        ...

    def recorded(self, records: Iterable[Recorded], left_out: Iterable[bytes]) -> None:
        """These records are on the disk now, and these that were left are not any more."""
        ...

    def leave(self, execution_id: bytes) -> None:
        """A request that was prepared, and recorded, is not made after all."""
        ...

    @property
    def left(self) -> tuple[bytes, ...]:
        """Requests that were recorded and left, and are to be deleted."""
        ...

    def halt(self, topic: Topic, robot: str, execution_id: bytes) -> None:
        """Have a robot stop an execution."""
        ...

    def inquire(self, execution_id: bytes) -> None:
        """Ask once more what became of a request that nobody has answered."""
        ...

    def known_outcome(self, execution_id: bytes) -> RequestOutcome | None:
        """What is known of a request; None while it is asked for, KeyError where it was never made."""
        ...


def call_of(
    task: TaskStarted, robot: RobotModel, skill: SkillModel
) -> tuple[Topic, str, str, dict[str, Value], float, bytes]:
    """What is asked for, as `Requests.request` takes it."""
    assert robot.skill_status is not None
    topic = Topic(robot.skill_status.space, robot.ns, skill.id)
    timeout_s = skill.timeout_s if skill.immediate else min(START_WITHIN_S, skill.timeout_s)
    given = skill.filled(task.arguments)
    named = {argument.name: _typed(argument.type, given[argument.name]) for argument in skill.arguments}
    return topic, robot.name, skill.name, named, timeout_s, bytes.fromhex(task.execution_id)


def _typed(kind: int, value: Value) -> Value:
    """A legal value in the type of its argument: YAML writes 0 where a Double is meant."""
    if isinstance(value, bool | str):
        return value
    return float(value) if kind in _FLOATS else int(value)
