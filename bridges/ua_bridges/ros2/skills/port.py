# pyright: basic, reportMissingImports=false
"""One skill of one robot in the ROS 2 graph: what the topic, service, action and program ports have in common.

event loop      prepare                  checks, and makes the robot's message; or refuses
node's thread   opened, begin, query, cancel, turn, overdue, heard
"""

from __future__ import annotations

import importlib
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final, Literal

from ua_bridges.ros.errors import ConversionError, SchemaInvalid
from ua_bridges.ros.executing import Executing, Open
from ua_bridges.ros.schema import MessageSchema, schema_from_ros2
from ua_bridges.ros.skill_values import Ended
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros2.classes import TypeMissing, load_type
from ua_bridges.ros2.node import Ros2Node
from ua_fleet.bridge.driver import DriverEvent, Execution
from ua_fleet.config.schema import QosConfig
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.values import StatusCode

__all__ = ["APPEARS_S", "SkillPort", "find_type", "part_schema"]

APPEARS_S: Final = 3.0
"""So long after the bridge's start the robot's side may be there and not be discovered yet."""


def find_type(ros_type: str, folder: Literal["srv", "action"]) -> Any:
    """The class of a service or action type; raises TypeMissing."""
    package, _, name = ros_type.replace(f"/{folder}/", "/").partition("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), name)
    except (ImportError, AttributeError):
        raise TypeMissing(ros_type, folder) from None


def part_schema(name: str, cls: Any) -> MessageSchema:
    """The schema of a part of a service or an action, whose class is at hand.

    Raises:
        TypeMissing, SchemaInvalid: a type in it is not installed, or has no flat form.
    """

    def field_types(wanted: str) -> Any:
        return (cls if wanted == name else load_type(wanted).cls).get_fields_and_field_types()

    return schema_from_ros2(name, field_types)


class SkillPort(ABC):
    """See the module."""

    def __init__(self, spec: SkillSpec, executing: Executing, put: Callable[[DriverEvent], None]) -> None:
        self.spec, self._executing, self._put = spec, executing, put
        self.problem = "; ".join(spec.problems())
        """Why the skill cannot be done as it is configured, ever; known when the port has opened."""
        self.absent = "the bridge is not in its domain yet"
        """What of the robot's side was missing at the last look; empty where all was there."""
        self.cannot_stop = ""
        """Why the robot cannot be stopped in this; empty where it can."""
        self._opened_at = 0.0
        self._waiting: dict[bytes, tuple[float, Callable[[float], None]]] = {}
        """What was begun while the robot's side was not seen yet: until when it waits, and the step to take."""

    # The event loop's side

    def prepare(self, execution: Execution) -> Any:
        """What `begin` needs to tell the robot.

        Raises:
            SkillRejected: it is configured wrongly, or the arguments do not fit.
            RobotOffline: the robot's side is not there.
        """
        if self.problem:
            raise SkillRejected(f"{self.spec.robot}.{self.spec.name} cannot be done: {self.problem}")
        if self.absent and time.monotonic() > self._opened_at + APPEARS_S:
            raise RobotOffline(self.absent)
        return self._request_of(execution)

    @abstractmethod
    def _request_of(self, execution: Execution) -> Any:
        """The robot's message for an execution; raises SkillRejected."""

    # The node's thread

    def opened(self, node: Ros2Node) -> None:
        """The node is there."""
        self._opened_at = time.monotonic()
        if self.problem:
            return
        try:
            self._open(node)
        except (ConversionError, SchemaInvalid, TypeMissing) as error:
            self.problem = str(error)

    @abstractmethod
    def _open(self, node: Ros2Node) -> None:
        """Find types and make entities; what it raises becomes the problem."""

    def listened(self) -> tuple[str, str, QosConfig] | None:
        """The topic whose messages this port wants to have: full name, type, quality of service."""
        return None

    def heard(self, message: Any) -> None:  # noqa: B027 - most listen to nothing
        """A message has come on that topic."""

    def source(self, problem: str) -> None:  # noqa: B027 - as above
        """That topic's publisher is there (the text is empty), or why not."""

    @abstractmethod
    def _look(self, now: float) -> str:
        """What of the robot's side is missing now, with what to do; empty where all is there."""

    def turn(self, now: float) -> None:
        """Do what is due; called at each look at the graph."""
        if self.problem:
            return
        self.absent = self._look(now)
        for execution_id, (until, step) in list(self._waiting.items()):
            if self.absent and now < until:
                continue
            del self._waiting[execution_id]
            if self._executing.get(execution_id) is None:
                continue
            if self.absent:
                self._executing.end(execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), self.absent))
            else:
                step(now)

    def begin(self, execution: Execution, request: Any, now: float) -> None:
        """Tell the robot; in the first seconds, once it is seen."""
        execution_id = execution.execution_id
        self._executing.begin(self.spec, execution, now)
        if self._look(now):
            self._waiting[execution_id] = (
                self._opened_at + APPEARS_S,
                lambda at: self._tell(execution_id, request, at),
            )
        else:
            self._tell(execution_id, request, now)

    @abstractmethod
    def _tell(self, execution_id: bytes, request: Any, now: float) -> None:
        """Tell the robot now."""

    def query(self, execution: Execution, now: float) -> None:
        """Ask the robot what became of an execution that a bridge before us may have begun."""
        self._executing.begin(self.spec, execution, now)
        if self.problem:
            self._executing.forget(execution.execution_id, self.problem)
        else:
            self._ask(execution.execution_id, now)

    @abstractmethod
    def _ask(self, execution_id: bytes, now: float) -> None:
        """Ask the robot, or say that it cannot be asked."""

    def cancel(self, execution_id: bytes, now: float) -> None:
        """Have the robot stop, where it can; its end is told as any other."""
        if self._waiting.pop(execution_id, None) is not None:
            self._halted(execution_id)
        elif self._executing.get(execution_id) is not None:
            self._stop(execution_id, now)

    @abstractmethod
    def _stop(self, execution_id: bytes, now: float) -> None:
        """Tell the robot to stop, where it can."""

    def overdue(self, opened: Open, now: float) -> None:
        """An execution has taken too long."""
        if self._waiting.pop(opened.execution_id, None) is not None:
            self._executing.end(opened.execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), self.absent))
        else:
            self._give_up(opened, now)

    def _give_up(self, opened: Open, now: float) -> None:
        """Have the robot stop, where it can, and say that it took too long."""
        self._executing.end(opened.execution_id, self._too_long("see what the robot does"))

    def _too_long(self, more: str) -> Ended:
        return Ended(StatusCode.BAD_TIMEOUT, (), f"it took longer than {self.spec.config.timeout_s:g} s; {more}")

    def _halted(self, execution_id: bytes) -> None:
        """The robot was stopped, or was never told."""
        self._executing.end(execution_id, Ended(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), "it was halted"))
