"""What is known of the robots of a fleet now: faults, who is silent, held, or driven by hand. Runs ask it at each
decision.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from math import inf
from typing import Final

from ua_fleet.orchestrator.candidates import ResilienceSettings, TaskToDo
from ua_fleet.orchestrator.faults import Fault, FaultChange, Faults
from ua_fleet.orchestrator.holds import Holds
from ua_fleet.scenario import FleetView
from ua_fleet.scenario.consequences import BUSY_S, SILENT, meaning_of
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.world import Trouble

__all__ = ["Knowledge"]

MOST_EXECUTIONS: Final = 10_000
"""Executions of runs that are told from those of others."""
_SILENT: Final = "is silent"
_ELSEWHERE: Final = "is at what no run has asked for"


class Knowledge:
    """See `scenario.world.World`."""

    def __init__(self, settings: ResilienceSettings, fleet: FleetView) -> None:
        """Know of no faults; all robots are heard until `not_heard`."""
        self.settings, self.fleet = settings, fleet
        self.faults = Faults()
        self.holds = Holds()
        self.version = 0
        """Another one whenever something else is known of robots, or how replacements are chosen."""
        self.explain_silence: Callable[[str], str] = _unexplained
        """See `why_silent`."""
        self._driven: dict[str, str] = {}
        """Robots that people drive by hand, with what is said of that: `is driven by hand by anna`."""
        self._silent: dict[str, float] = {}
        """Since when, by the wall clock."""
        self._followed: dict[str, frozenset[str]] = {}
        """The executions that robots say they are at."""
        self._followed_until: dict[str, float] = {}
        """Until when robots said so of executions of runs that they say it of no more."""
        self._of_runs: dict[str, None] = {}
        """Executions that runs have asked for, also those that are over: their robots may say it later."""

    def changed(self) -> None:
        """Something is not as it was: who has looked before may look again."""
        self.version += 1

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

    def why_silent(self, robot: str) -> str:
        """See World."""
        return self.explain_silence(robot)

    def why_not(self, robot: str, reason: str, task: Task) -> str:
        """Why a robot is no candidate for a task, for people, with all that is known of a fault, silence or hold.

        Args:
            robot: its name.
            reason: as the ranking says it.
            task: what it would do.
        """
        needs = self.needs(robot, task)
        if reason == self.faults.unfit(robot, needs) and (trouble := self.trouble(robot, needs)) is not None:
            return trouble.told
        if reason == _SILENT and (why := self.why_silent(robot)):
            return f"{robot} {reason}: {why}"
        if (hold := self.holds.get(robot)) is not None and reason == hold.brief:
            return hold.told
        return f"{robot} {reason}"

    def followed_until(self, robot: str, execution_id: str) -> float:
        """See World."""
        if execution_id in self._followed.get(robot, ()):
            return inf
        return self._followed_until.get(execution_id, -inf)

    def occupied(self, robot: str) -> str | None:
        """See World."""
        if (hold := self.holds.get(robot)) is not None:
            return hold.told
        if (driven := self._driven.get(robot)) is not None:
            return f"{robot} {driven}"
        return f"{robot} {_ELSEWHERE}" if self._is_elsewhere(robot) else None

    def drive(self, robot: str, told: str) -> bool:
        """Somebody drives a robot by hand, in words that follow its name; empty: nobody. Whether that is news."""
        if told == self._driven.get(robot, ""):
            return False
        if told:
            self._driven[robot] = told
        else:
            del self._driven[robot]
        self.changed()
        return True

    def _is_elsewhere(self, robot: str) -> bool:
        return any(execution_id not in self._of_runs for execution_id in self._followed.get(robot, ()))

    def asked_for(self, execution_id: str) -> None:
        """A run has a robot do this."""
        if any(execution_id in told for told in self._followed.values()):
            self.changed()
        self._of_runs.pop(execution_id, None)
        self._of_runs[execution_id] = None
        if len(self._of_runs) > MOST_EXECUTIONS:
            del self._of_runs[next(iter(self._of_runs))]

    def follow(self, robot: str, told: frozenset[str], under_way: Collection[str], now: float) -> bool:
        """A robot says what it is at, or nothing says it any more; whether that changes what is known of runs.

        Args:
            robot: its name.
            told: the executions that it is at.
            under_way: those of all runs; of others nothing is remembered.
            now: by the wall clock.
        """
        before, was_elsewhere = self._followed.get(robot, frozenset()), self._is_elsewhere(robot)
        changed = {execution_id for execution_id in before ^ told if execution_id in under_way}
        self._followed[robot] = told
        has_changed_place = self._is_elsewhere(robot) != was_elsewhere
        if has_changed_place:
            self.changed()
        if not changed:
            return has_changed_place
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
        told = "; ".join(fault.told for fault in keeping)
        return Trouble(keeping[0].reason, any(meaning_of(fault.source).stands for fault in keeping), told)

    def not_heard(self, robots: Iterable[str], now: float) -> None:
        """Nothing is heard of robots, from now on."""
        self._silent.update(dict.fromkeys(robots, now))
        self.changed()

    def forget(self, robot: str) -> None:
        """A robot is gone."""
        self._silent.pop(robot, None)
        self._driven.pop(robot, None)
        self._followed.pop(robot, None)
        self.changed()

    def raised(
        self, robot: str, source: str, reason: str, now: float, capacities: tuple[str, ...] = ()
    ) -> tuple[Fault, FaultChange] | None:
        """Something is wrong with a robot; None where that is known already."""
        self.changed()
        if source == SILENT:
            self._silent.setdefault(robot, now)
        return self.faults.raise_fault(robot, source, reason, now, capacities)

    def cleared(self, robot: str, source: str) -> tuple[Fault, FaultChange] | None:
        """It is over; None where there was nothing."""
        self.changed()
        if source == SILENT:
            self._silent.pop(robot, None)
        return self.faults.clear(robot, source)

    def unfit(self, robot: str, needs: Collection[str]) -> str | None:
        """Why a robot cannot be given now what needs these capacities; None where it can."""
        if (reason := self.faults.unfit(robot, needs)) is not None:
            return reason
        if robot in self._silent:
            return _SILENT
        if (hold := self.holds.get(robot)) is not None:
            return hold.brief
        if (driven := self._driven.get(robot)) is not None:
            return driven
        return _ELSEWHERE if self._is_elsewhere(robot) else None

    def hope_until(self, todo: TaskToDo, since: float, now: float) -> float | None:
        """Until when a robot may still be heard, or be free, that could do a task; None where there is none, or no time
        left.

        Args:
            todo: what has to be done.
            since: since when somebody is looked for.
            now: by the wall clock.
        """
        until: list[float] = []
        for robot in self.fleet.able(todo.task.skill, todo.capacities):
            needs = (*todo.capacities, *self.needs(robot.name, todo.task))
            if robot.name in todo.excluded or self.faults.unfit(robot.name, needs) is not None:
                continue
            if robot.name in self._silent:
                at = self._silent[robot.name] + self.silence_s
            elif robot.name != todo.failed and self.occupied(robot.name) is not None:
                at = since + BUSY_S
            else:
                continue
            if at > now and not todo.problems(robot):
                until.append(at)
        return max(until, default=None)


def _unexplained(robot: str) -> str:
    del robot
    return ""
