"""One skill of one robot in a ROS graph: what the topic, service, action and program ports have in common.

event loop         prepare                  checks, and makes the robot's message; or refuses
the skills' thread opened, begin, query, cancel, turn, overdue, and what is heard
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Final, Generic, NamedTuple, Protocol, TypeVar

from ua_bridges.ros.schema import MessageSchema
from ua_bridges.ros.skills import SkillSpec
from ua_bridges.ros.topic_mapping import QosConfig
from ua_fleet.bridge.driver import DriverEvent, Execution
from ua_fleet.bridge.executing import Ended, Executing, Open, halted
from ua_fleet.errors import RobotOffline, SkillRejected, UaFleetError
from ua_fleet.values import StatusCode

__all__ = ["APPEARS_S", "Graph_contra", "Listened", "LoadedType", "SkillGraph", "SkillPort", "Spoken"]

APPEARS_S: Final = 3.0
"""So long after the bridge's start the robot's side may be there and not be discovered yet."""
STOP_AGAIN_S: Final = 1.0
"""A robot is told to stop an execution no more often than this."""


class LoadedType(NamedTuple):
    """A message type that is installed here."""

    cls: type[Any]
    schema: MessageSchema


class Spoken(Protocol):
    """A topic that a port publishes to."""

    def look(self, now: float) -> str:
        """Why nobody would hear a message now; empty where somebody would."""
        ...

    def publish(self, message: Any) -> None:
        """Publish."""
        ...


class SkillGraph(Protocol):
    """What ports need of a ROS graph."""

    def load(self, ros_type: str) -> LoadedType:
        """An installed message type, `pkg/Name`; raises UaFleetError with what to install."""
        ...

    def speak(self, name: str, ros_type: str, qos: QosConfig) -> Spoken:
        """Publish a topic by its full name; raises UaFleetError."""
        ...


class Listened(NamedTuple):
    """A topic that a port wants to hear. Both functions are called in the skills' thread."""

    name: str
    """Full name."""
    type: str
    """`pkg/Name`."""
    qos: QosConfig
    heard: Callable[[Any], None]
    """Gets each message."""
    source: Callable[[str], None]
    """Told that the topic's publisher is there (the text is empty), or why not."""


class _Stop:
    """An execution that is to stop, and has not ended."""

    __slots__ = ("is_due", "told_at")

    def __init__(self) -> None:
        self.is_due = True
        """Whether the robot is to be told (again)."""
        self.told_at: float | None = None
        """When it was told last."""


Graph_contra = TypeVar("Graph_contra", bound=SkillGraph, contravariant=True)


class SkillPort(ABC, Generic[Graph_contra]):
    """See the module."""

    repeats_halt: ClassVar[bool] = True
    """Whether the robot is told to stop until the execution ends: one word may be lost, or come before the robot has
    begun. It names the execution, and so disturbs no other."""

    def __init__(self, spec: SkillSpec, executing: Executing, put: Callable[[DriverEvent], None]) -> None:
        self.spec, self._executing, self._put = spec, executing, put
        self.problem = ""
        """Why the skill cannot be done as it is configured, ever; known when the port has opened."""
        self.absent = "the bridge is not in its graph yet"
        """What of the robot's side was missing at the last look; empty where all was there."""
        self.cannot_stop = ""
        """Why the robot cannot be stopped in this; empty where it can."""
        self.cannot_suspend = "a robot stands and goes on only in what its own program offers; this skill has `via`"
        """The same for standing in the middle of it."""
        self._opened_at = 0.0
        self._stopping: dict[bytes, _Stop] = {}
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

    # The skills' thread

    def opened(self, graph: Graph_contra) -> None:
        """The bridge's node is there."""
        self._opened_at = time.monotonic()
        if self.problem:
            return
        try:
            self._open(graph)
        except UaFleetError as error:
            self.problem = str(error)

    @abstractmethod
    def _open(self, graph: Graph_contra) -> None:
        """Find types and make publishers; what it raises becomes the problem."""

    def listened(self) -> tuple[Listened, ...]:
        """The topics that this port wants to hear; asked for before it is opened."""
        return ()

    @abstractmethod
    def _look(self, now: float) -> str:
        """What of the robot's side is missing now, with what to do; empty where all is there."""

    def turn(self, now: float) -> None:
        """Do what is due; called several times a second."""
        if self.problem:
            return
        self.absent = self._look(now)
        self._tell_to_stop(now)
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
            self._have_stopped(execution_id, now)

    def _have_stopped(self, execution_id: bytes, now: float) -> str:
        """Tell the robot to stop, now or when it is there; why it has not been told yet, empty where it has."""
        stop = self._stopping.setdefault(execution_id, _Stop())
        stop.is_due = True
        self._tell_to_stop(now)
        return self._cannot_be_told(now) if stop.told_at is None else ""

    def _tell_to_stop(self, now: float) -> None:
        for execution_id, stop in list(self._stopping.items()):
            if self._executing.get(execution_id) is None:
                del self._stopping[execution_id]
                continue
            is_soon = stop.told_at is not None and now < stop.told_at + STOP_AGAIN_S
            if stop.is_due and not is_soon and not self._cannot_be_told(now):
                stop.is_due, stop.told_at = self.repeats_halt, now
                self._stop(execution_id, now)

    def _cannot_be_told(self, now: float) -> str:
        """Why the robot would not hear now that it is to stop; empty where it would."""
        return self._look(now)

    @abstractmethod
    def _stop(self, execution_id: bytes, now: float) -> None:
        """Tell the robot to stop, where it can."""

    def suspend(self, execution_id: bytes) -> None:
        """Tell the robot to stand in the middle of an execution that is under way; see `cannot_suspend`."""
        raise SkillRejected(self.cannot_suspend)

    def resume(self, execution_id: bytes) -> None:
        """Tell the robot to go on with it; see `cannot_suspend`."""
        raise SkillRejected(self.cannot_suspend)

    def overdue(self, opened: Open, now: float) -> None:
        """An execution has taken too long."""
        if self._waiting.pop(opened.execution_id, None) is not None:
            self._executing.end(opened.execution_id, Ended(StatusCode.BAD_NO_COMMUNICATION, (), self.absent))
        else:
            self._give_up(opened, now)

    def _give_up(self, opened: Open, now: float) -> None:
        """Have the robot stop, where it can, and say that it took too long."""
        self._executing.end(opened.execution_id, self._too_long("see what the robot does"))

    @staticmethod
    def _untold(why: str) -> str:
        """What people are to know of a robot that goes on since it could not be told to stop."""
        return f"it could not be told to stop: {why}; see what the robot does"

    def _too_long(self, more: str) -> Ended:
        return Ended(StatusCode.BAD_TIMEOUT, (), f"it took longer than {self.spec.config.timeout_s:g} s; {more}")

    def _halted(self, execution_id: bytes) -> None:
        """The robot was stopped, or was never told."""
        self._executing.end(execution_id, halted())
