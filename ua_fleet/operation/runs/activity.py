"""What each robot is at, which faults it has and who holds it, gathered from all that the service says. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

from ua_fleet.fleet.moved import MovedRobots
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.orchestrator import Fault, FaultChanged, Hold, HoldChanged, Output, RunChanged
from ua_fleet.scenario.consequences import SILENT
from ua_fleet.scenario.state import RunState, TaskPhase

__all__ = ["RobotActivities", "RobotActivity"]

_AT: Final = frozenset(
    {TaskPhase.ASSIGNED, TaskPhase.ACCEPTED, TaskPhase.HALTING, TaskPhase.ASKED, TaskPhase.LOST},
)
"""Phases in which a task's robot is at it, or may be."""


class RobotActivity(NamedTuple):
    """Of one robot."""

    tasks: tuple[str, ...] = ()
    """Of runs, the first first."""
    run_id: str = ""
    """The run of the first task."""
    hold: Hold | None = None
    """Who holds it back from tasks; None: nobody."""
    faults: int = 0
    """How many are active."""
    fault: str = ""
    """The first of them, for people; silence only where there is no other."""


_NONE: Final = RobotActivity()


class RobotActivities:
    """Of all robots."""

    def __init__(self) -> None:
        self._tasks: dict[str, dict[tuple[str, str], str]] = {}
        """Of each robot the tasks, by run and step."""
        self._robots: dict[str, dict[str, str]] = {}
        """Of each run who is at which step."""
        self._faults: dict[str, dict[str, Fault]] = {}
        """Of each robot those that are active, by their ids."""
        self._holds: dict[str, Hold] = {}
        self.moved = MovedRobots()
        """Robots of which something has changed."""

    def of(self, robot: str) -> RobotActivity:
        """What a robot is at."""
        tasks, faults = self._tasks.get(robot), self._faults.get(robot)
        hold = self._holds.get(robot)
        if not tasks and not faults and hold is None:
            return _NONE
        names, run_id, text = tuple((tasks or {}).values()), next(iter(tasks), ("", ""))[0] if tasks else "", ""
        if faults:
            fault = next((one for one in faults.values() if one.source != SILENT), None) or next(iter(faults.values()))
            text = f"lacks {', '.join(fault.capacities)}: {fault.reason}" if fault.capacities else fault.reason
        return RobotActivity(names, run_id, hold, len(faults or ()), text)

    def restored(self, records: Iterable[RunRecord], holds: Iterable[Hold]) -> None:
        """What the journal says."""
        for record in records:
            for step in record.state.tasks if record.state.outcome is None else ():
                self._look_at(record.run_id, step, record.state)
        for hold in holds:
            self._holds[hold.robot] = hold
            self.moved.add(hold.robot)

    def take(self, output: Output, run: RunState | None) -> None:
        """Something has happened, and was taken in by its run, if it is one's."""
        match output:
            case RunChanged(run_id=run_id, fact=fact) if run is not None:
                if run.outcome is not None:
                    for step in list(self._robots.get(run_id, ())):
                        self._leave(run_id, step)
                elif step := getattr(fact, "step", ""):
                    self._look_at(run_id, step, run)
            case FaultChanged(fault=fault):
                faults = self._faults.setdefault(fault.robot, {})
                if fault.active:
                    faults[fault.id] = fault
                else:
                    faults.pop(fault.id, None)
                    if not faults:
                        del self._faults[fault.robot]
                self.moved.add(fault.robot)
            case HoldChanged(hold=hold, is_held=is_held):
                if is_held:
                    self._holds[hold.robot] = hold
                else:
                    self._holds.pop(hold.robot, None)
                self.moved.add(hold.robot)
            case _:
                pass

    def _look_at(self, run_id: str, step: str, run: RunState) -> None:
        task = run.tasks.get(step)
        robot = task.executed_by or task.robot if task is not None and task.phase in _AT else ""
        before = self._robots.get(run_id, {}).get(step, "")
        if robot == before:
            return
        self._leave(run_id, step)
        if robot and task is not None:
            self._robots.setdefault(run_id, {})[step] = robot
            self._tasks.setdefault(robot, {})[run_id, step] = task.name
            self.moved.add(robot)

    def _leave(self, run_id: str, step: str) -> None:
        """Nobody is at a step any more."""
        steps = self._robots.get(run_id, {})
        robot = steps.pop(step, "")
        if not robot:
            return
        if not steps:
            del self._robots[run_id]
        tasks = self._tasks[robot]
        del tasks[run_id, step]
        if not tasks:
            del self._tasks[robot]
        self.moved.add(robot)
