"""A robot that takes three seconds for everything: the driver of a virtual bridge."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence

from ua_demo.simulators.fleet.fleet import TASK_S
from ua_fleet.bridge.driver import (
    Driver,
    DriverEvent,
    DriverStatus,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    Inlet,
    Skill,
)
from ua_fleet.errors import SkillRejected
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["VirtualRobot"]


class VirtualRobot(Driver):
    """A driver without a machine, a thread and an inlet. What it has to tell comes from `poll`."""

    def __init__(self, skill: Skill, clock: Callable[[], float], *, fails: bool) -> None:
        """Make a robot.

        Args:
            skill: the one that it has.
            clock: seconds.
            fails: whether it breaks down halfway through its first task, and stays so.
        """
        self._skills, self._clock, self._fails = (skill,), clock, fails
        self._is_broken = False
        self._ends: list[tuple[float, bytes]] = []
        self._said: list[DriverEvent] = []

    async def start(self, inlet: Inlet) -> None:
        """See Driver: there is nothing to watch."""

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver: it takes values of others, and does nothing with them."""
        return True

    def status(self) -> DriverStatus:
        """See Driver."""
        return DriverStatus(True, "a virtual robot")

    async def stop(self) -> None:
        """See Driver: there is nothing to leave."""

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        return self._skills

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        if self._is_broken:
            raise SkillRejected("its drive has failed")
        heapq.heappush(self._ends, (self._clock() + (TASK_S / 2 if self._fails else TASK_S), execution.execution_id))

    def query(self, execution: Execution) -> None:
        """See Driver: it remembers what it is at, and nothing else."""
        if execution.execution_id not in [execution_id for _, execution_id in self._ends]:
            self._said.append(ExecutionForgotten(execution.execution_id, "it does not remember that"))

    def poll(self, now: float) -> list[DriverEvent]:
        """What it has to tell by now."""
        said, self._said = self._said, []
        while self._ends and self._ends[0][0] <= now:
            _, execution_id = heapq.heappop(self._ends)
            if self._fails:
                self._is_broken = True
                said.append(ExecutionEnded(execution_id, StatusCode.BAD_OUT_OF_SERVICE, message="its drive has failed"))
            else:
                said.append(ExecutionEnded(execution_id))
        return said

    def next_deadline(self) -> float | None:
        """When `poll` has something to tell, or None."""
        return self._ends[0][0] if self._ends else None
