"""Robots that come to a fleet and leave it while it runs, and what stays of those that have left.

What people say of a robot (a hold, RaiseFault), and what they are to look at (a failed skill, a halt that it has not
confirmed), is about the machine and not about its registration: it stays until they take it back, and counts when a
robot of that name comes again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ua_fleet.fleet.model import RobotModel
from ua_fleet.operation.log import Log
from ua_fleet.operation.runs.holding import Do, RobotHolds
from ua_fleet.operation.runs.requests import TaskRequests
from ua_fleet.operation.runs.robot_news import RobotNews
from ua_fleet.orchestrator import Halt, Orchestrator
from ua_fleet.orchestrator.faults import BY_PERSON

__all__ = ["FleetMembership"]


class FleetMembership:
    """Takes robots in and lets them go, in the order in which nobody gets a task that is not to have it."""

    def __init__(
        self,
        robots: dict[str, RobotModel],
        orchestrator: Orchestrator,
        news: RobotNews,
        tasks: TaskRequests,
        holds: RobotHolds,
        do: Do,
        wall_s: Callable[[], float],
        log: Log,
    ) -> None:
        """Connect the parts.

        Args:
            robots: by their names; it is changed here.
            orchestrator: gives them to tasks.
            news: of robots.
            tasks: what robots are asked.
            holds: of robots.
            do: carries out what follows.
            wall_s: seconds since 1970, which nobody sets.
            log: is told what stays of a robot that leaves.
        """
        self._robots, self._orchestrator, self._news, self._tasks = robots, orchestrator, news, tasks
        self._holds, self._do, self._wall_s, self._log = holds, do, wall_s, log
        self.parted: Sequence[Halt] = ()
        """What robots were to stop that were not in the fleet any more at the start."""

    def add(self, robot: RobotModel, *, is_heard: bool) -> None:
        """A robot has come: scenarios may use it from now on."""
        halts = [halt for halt in self.parted if halt.robot == robot.name]
        self.parted = [halt for halt in self.parted if halt.robot != robot.name]
        if halts:
            self._do(self._orchestrator.halts_found(halts, self._wall_s()))  # before it could be given to a task
        self._robots[robot.name] = robot
        self._tasks.add(robot)
        self._news.add(robot, is_heard=is_heard)
        self._holds.show_again(robot.name)

    def remove(self, name: str, *, is_replaced: bool = False) -> None:
        """A robot that no run uses is gone, with the faults that were found.

        Args:
            name: of it.
            is_replaced: whether it comes again at once, with another definition: then all that is known of it stays,
                and no task that waits looks for a robot in between.
        """
        robot = self._robots.pop(name)
        if is_replaced:
            self._news.replace(robot)
            self._tasks.replace(robot)
            return
        self._news.remove(robot)  # before its faults are over: it could be given to a task
        self._tasks.remove(robot)
        for fault in self._orchestrator.faults.active(name):
            if fault.source not in BY_PERSON:
                self._do(self._orchestrator.fault_cleared(name, fault.source, self._wall_s()))
        self._orchestrator.forget(name)
        if told := self.told_of(name):
            self._log.warning("robot is gone, and what people said of it stays", robot=name, reason="; ".join(told))

    def told_of(self, name: str) -> list[str]:
        """What people say of a robot, or are to look at: faults, halts, and who holds it."""
        told = [fault.told for fault in self._orchestrator.faults.active(name) if fault.source in BY_PERSON]
        told += [
            f"{name} was told to stop {halt.skill}, and has not said that it has"
            for halt in self._orchestrator.halts_of(name)
        ]
        if (hold := self._orchestrator.holds.get(name)) is not None:
            told.append(hold.told if name in self._robots else f"{name} {hold.brief}")
        return told
