"""Executions as the log and the metrics tell them: one line when one begins, one when it ends.

They follow the transitions that clients are told of. What is found out later of an execution that nobody could tell of
changes nothing here: it ended as unknown.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import structlog

from ua_fleet.monitoring import Monitor, metrics
from ua_fleet.monitoring.metrics import MOST_ROBOTS, MOST_SKILLS
from ua_fleet.operation.skills.program import ProgramState
from ua_fleet.operation.skills.tracker import SkillTransitioned
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.values import TICKS_PER_SECOND, status_name

__all__ = ["OTHER", "SkillEnds"]

OTHER: Final = "(other)"
"""Label of the skills that are too many to have one of their own."""
_BUCKETS_S: Final = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)
_UNDER_WAY: Final = (ProgramState.RUNNING, ProgramState.SUSPENDED)

_log: Any = structlog.get_logger("ua_fleet.skills")


class SkillEnds:
    """Counts and logs the executions of one server."""

    def __init__(self, monitor: Monitor) -> None:
        """Begin with none."""
        metric = metrics.SKILL_SECONDS
        self._seconds = monitor.histogram(metric.name, metric.help, _BUCKETS_S, metric.labels)
        self._names: set[str] = set()
        self._left_out: set[str] = set()
        self.by_robot: Counter[tuple[str, ...]] = Counter()
        """How many executions have ended, by robot and outcome."""
        self._robots: set[str] = set()

    @property
    def names_left_out(self) -> int:
        """Skills without a label of their own, as far as they are counted."""
        return len(self._left_out)

    def moved(self, change: SkillTransitioned) -> None:
        """A skill went from one state to another."""
        before, after = change.transition.ends
        execution = change.execution
        ids = {"robot": change.robot, "skill": change.skill.name, "execution_id": execution.id.hex()}
        if after is ProgramState.RUNNING and before is not ProgramState.SUSPENDED:
            _log.info("skill begins", **ids)
        elif after is ProgramState.SUSPENDED:
            _log.info("skill suspended", **ids)
        elif before is ProgramState.SUSPENDED and after is ProgramState.RUNNING:
            _log.info("skill goes on", **ids)
        elif before in _UNDER_WAY and execution.is_over:
            outcome = execution.state.name.lower()
            seconds = max(0, (execution.ended or change.ticks) - execution.began) / TICKS_PER_SECOND
            said = {"status": status_name(execution.status)} if execution.status else {}
            if execution.message:
                said["reason"] = execution.message
            tell = _log.info if execution.state is ExecutionState.DONE else _log.warning
            tell("skill ended", **ids, outcome=outcome, seconds=round(seconds, 3), **said)
            self._count(change.robot, change.skill.name, outcome, seconds)

    def _count(self, robot: str, skill: str, outcome: str, seconds: float) -> None:
        self._seconds.labels(self._label(skill), outcome).observe(seconds)
        if robot in self._robots or len(self._robots) < MOST_ROBOTS:
            self._robots.add(robot)
            self.by_robot[robot, outcome] += 1

    def _label(self, skill: str) -> str:
        if skill in self._names:
            return skill
        if len(self._names) < MOST_SKILLS:
            self._names.add(skill)
            return skill
        if len(self._left_out) < MOST_ROBOTS:
            self._left_out.add(skill)
        return OTHER
