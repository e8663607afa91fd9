"""What is known of the robots of a fleet now: their faults, and who is silent. Runs ask it at each decision."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import inf

from ua_fleet.orchestrator.candidates import ResilienceSettings, TaskToDo
from ua_fleet.orchestrator.faults import Fault, FaultChange, Faults
from ua_fleet.scenario import FleetView
from ua_fleet.scenario.consequences import SILENT, meaning_of
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.world import Trouble

__all__ = ["Knowledge"]


class Knowledge:
    """See `scenario.world.World`."""

    def __init__(self, settings: ResilienceSettings, fleet: FleetView) -> None:
        """Know of no faults; all robots are heard until `not_heard`."""
        self.settings, self.fleet = settings, fleet
        self.faults = Faults()
        self._silent: dict[str, float] = {}
        """Since when, by the wall clock."""
        self._followed: dict[str, frozenset[str]] = {}
        """The executions that robots say they are at."""
        self._followed_until: dict[str, float] = {}
        """Until when robots said so of executions of runs that they say it of no more."""

    @property
    def silence_s(self) -> float:
        """See World."""
        return self.settings.silence_s

    @property
    def return_s(self) -> float:
        """See World."""
        return self.settings.return_s

    def silent_since(self, robot: str) -> float | None:
        """See World."""
        return self._silent.get(robot)

    def followed_until(self, robot: str, execution_id: str) -> float:
        """See World."""
        if execution_id in self._followed.get(robot, ()):
            return inf
        return self._followed_until.get(execution_id, -inf)

    def follow(self, robot: str, told: frozenset[str], under_way: Collection[str], now: float) -> bool:
        """A robot says what it is at, or nothing says it any more; whether that changes what is known of runs.

        Args:
            robot: its name.
            told: the executions that it is at.
            under_way: those of all runs; of others nothing is remembered.
            now: by the wall clock.
        """
        before = self._followed.get(robot, frozenset())
        changed = {execution_id for execution_id in before ^ told if execution_id in under_way}
        self._followed[robot] = told
        if not changed:
            return False
        self._followed_until = {key: at for key, at in self._followed_until.items() if key in under_way}
        self._followed_until.update(dict.fromkeys(changed - told, now))
        return True

    def needs(self, robot: str, task: Task) -> tuple[str, ...]:
        """See World."""
        return tuple(dict.fromkeys((*task.capacities, *self.fleet.needs(robot, task.skill))))

    def trouble(self, robot: str, needs: Collection[str] = ()) -> Trouble | None:
        """See World."""
        keeping = self.faults.keeping(robot, needs)
        if not keeping:
            return None
        return Trouble(keeping[0].reason, any(meaning_of(fault.source).stands for fault in keeping))

    def not_heard(self, robots: Iterable[str], now: float) -> None:
        """Nothing is heard of robots, from now on."""
        self._silent.update(dict.fromkeys(robots, now))

    def forget(self, robot: str) -> None:
        """A robot is gone."""
        self._silent.pop(robot, None)
        self._followed.pop(robot, None)

    def raised(
        self, robot: str, source: str, reason: str, now: float, capacities: tuple[str, ...] = ()
    ) -> tuple[Fault, FaultChange] | None:
        """Something is wrong with a robot; None where that is known already."""
        if source == SILENT:
            self._silent.setdefault(robot, now)
        return self.faults.raise_fault(robot, source, reason, now, capacities)

    def cleared(self, robot: str, source: str) -> tuple[Fault, FaultChange] | None:
        """It is over; None where there was nothing."""
        if source == SILENT:
            self._silent.pop(robot, None)
        return self.faults.clear(robot, source)

    def unfit(self, robot: str, needs: Collection[str]) -> str | None:
        """Why a robot cannot be given now what needs these capacities; None where it can."""
        return self.faults.unfit(robot, needs) or ("is silent" if robot in self._silent else None)

    def hope_until(self, todo: TaskToDo, now: float) -> float | None:
        """Until when a robot may still be heard that could do a task; None where there is none, or no time left."""
        task = todo.task
        able = [
            robot
            for robot in self.fleet.able(task.skill, todo.capacities)
            if robot.name in self._silent
            and robot.name not in todo.excluded
            and self.faults.unfit(robot.name, (*todo.capacities, *self.needs(robot.name, task))) is None
        ]
        until = [self._silent[robot.name] + self.silence_s for robot in able if not todo.problems(robot)]
        return max((at for at in until if at > now), default=None)
