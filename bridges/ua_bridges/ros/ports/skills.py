"""All skills of a bridge: from the event loop to the ports, and what is due of each.

`execute` and `query` check in the event loop and hand over; everything else runs in the skills' thread, which the owner
has (`call` puts a step into it).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, Generic, TypeVar

import structlog

from ua_bridges.ros.ports.port import SkillGraph, SkillPort
from ua_bridges.ros.skills import SkillSpec
from ua_fleet.bridge.driver import DriverEvent, Execution, ExecutionForgotten
from ua_fleet.bridge.executing import Executing
from ua_fleet.errors import RobotOffline, SkillRejected

__all__ = ["MakePort", "RobotSkills"]

_log = structlog.get_logger("ua_bridges.ros")

Graph = TypeVar("Graph", bound=SkillGraph)
MakePort = Callable[[SkillSpec, Executing, Callable[[DriverEvent], None]], SkillPort[Graph]]


class RobotSkills(Generic[Graph]):
    """See the module."""

    def __init__(
        self,
        specs: Sequence[SkillSpec],
        make_port: MakePort[Graph],
        put: Callable[[DriverEvent], None],
        call: Callable[[Callable[[], None]], None],
    ) -> None:
        """Make the ports, which are not open yet.

        Args:
            specs: the skills in `fleet.yaml`.
            make_port: the port of a skill.
            put: of the inlet.
            call: has a step done in the skills' thread, soon.
        """
        self._put, self._call = put, call
        self._executing = Executing(put)
        self._ports = {spec.topic: make_port(spec, self._executing, put) for spec in specs}
        self._begun_by: dict[bytes, SkillPort[Graph]] = {}

    def __iter__(self) -> Iterator[SkillPort[Graph]]:
        """The ports."""
        return iter(self._ports.values())

    def opened(self, graph: Graph) -> None:
        """The bridge's node is there."""
        for port in self:
            port.opened(graph)
            if port.problem:
                _log.error("a skill cannot be done", robot=port.spec.robot, skill=port.spec.name, reason=port.problem)

    # The event loop's side

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        port = self._ports.get(execution.topic)
        if port is None:
            raise RobotOffline("the skill is not in the fleet.yaml of this bridge")
        self._call(partial(self._begin, port, execution, port.prepare(execution)))

    def query(self, execution: Execution) -> None:
        """See Driver."""
        port = self._ports.get(execution.topic)
        if port is None:
            said = "the skill is no longer in fleet.yaml; see what the robot did"
            self._put(ExecutionForgotten(execution.execution_id, said))
        else:
            self._call(partial(self._ask, port, execution))

    def halt(self, execution: Execution) -> None:
        """See Driver."""
        port = self._ports.get(execution.topic)
        if port is None:
            raise RobotOffline("the skill is not in the fleet.yaml of this bridge")
        if port.cannot_stop:
            raise SkillRejected(port.cannot_stop)
        self._call(partial(self._cancel, execution.execution_id))

    def suspend(self, execution: Execution) -> None:
        """See Driver."""
        self._call(partial(self._stand, self._suspendable(execution), execution.execution_id))

    def resume(self, execution: Execution) -> None:
        """See Driver."""
        self._call(partial(self._go_on, self._suspendable(execution), execution.execution_id))

    def _suspendable(self, execution: Execution) -> SkillPort[Graph]:
        port = self._ports.get(execution.topic)
        if port is None:
            raise RobotOffline("the skill is not in the fleet.yaml of this bridge")
        if port.cannot_suspend:
            raise SkillRejected(port.cannot_suspend)
        if port.absent:
            raise RobotOffline(port.absent)
        return port

    # The skills' thread

    @property
    def is_busy(self) -> bool:
        """Whether an execution is under way."""
        return bool(self._begun_by)

    def _begin(self, port: SkillPort[Graph], execution: Execution, request: Any) -> None:
        self._begun_by[execution.execution_id] = port
        try:
            port.begin(execution, request, time.monotonic())
        except Exception:  # noqa: BLE001 - whatever it was, the robot may have been told
            _log.exception("a skill could not be begun", robot=port.spec.robot, skill=port.spec.name)
            self._executing.forget(execution.execution_id, "the bridge failed while it began this; see its log")

    def _ask(self, port: SkillPort[Graph], execution: Execution) -> None:
        self._begun_by[execution.execution_id] = port
        port.query(execution, time.monotonic())

    def _cancel(self, execution_id: bytes) -> None:
        port = self._begun_by.get(execution_id)
        if port is not None:
            port.cancel(execution_id, time.monotonic())

    def _stand(self, port: SkillPort[Graph], execution_id: bytes) -> None:
        if self._executing.get(execution_id) is not None:
            port.suspend(execution_id)

    def _go_on(self, port: SkillPort[Graph], execution_id: bytes) -> None:
        if self._executing.get(execution_id) is not None:
            port.resume(execution_id)

    def turn(self, now: float) -> None:
        """Do what is due."""
        for opened in self._executing.overdue(now):
            port = self._begun_by.get(opened.execution_id)
            if port is not None:
                self._guarded(port, partial(port.overdue, opened, now))
        for port in self:
            self._guarded(port, partial(port.turn, now))
        for execution_id in [each for each in self._begun_by if self._executing.get(each) is None]:
            del self._begun_by[execution_id]

    @staticmethod
    def _guarded(port: SkillPort[Graph], step: Callable[[], None]) -> None:
        try:
            step()
        except Exception:  # noqa: BLE001 - one skill's mistake must not end the others
            _log.exception("a skill's step has failed", robot=port.spec.robot, skill=port.spec.name)
