"""The course of one run, from what the server tells: pure, fed with events, asked for lines and for the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any, Final

from ua_fleet.client import (
    DecisionInfo,
    DecisionTold,
    FaultTold,
    RankedRobot,
    RankingInfo,
    RunInfo,
    RunTold,
    StepTold,
    Told,
)

__all__ = ["TASKS", "Course", "TaskRow", "ranking_lines"]

TASKS: Final = 9
_NO_RANKING: Final = RankingInfo((), (), 0.0, (), ())
_ENDS: Final = ("done", "failed", "aborted")
_TASK_ENDS: Final = ("done", "failed")


@dataclass(slots=True)
class TaskRow:
    """One task. Times are the demonstration's seconds from the start of the run: wall time times speed."""

    task: str
    robot: str
    skill: str
    state: str
    started_s: float
    """When the robot that has it now was asked."""
    ended_s: float | None = None


@dataclass(slots=True)
class _Fault:
    robot: str
    detected_s: float
    task: str | None = None
    replacement: str | None = None
    decided_s: float | None = None
    ranking: RankingInfo | None = None


class Course:
    """Takes in what is told of one run, and of faults meanwhile."""

    def __init__(self, run_id: str, speed: float, units: Mapping[str, str], tasks: int = TASKS) -> None:
        """Begin a run.

        Args:
            run_id: of the server.
            speed: how many times faster than in the paper.
            units: of the criteria of rankings.
            tasks: how many there are.
        """
        self.run_id = run_id
        self._tasks = tasks
        self.speed = speed
        self.outcome: str | None = None
        """`done`, `failed` or `aborted`, once it has ended."""
        self.reason = ""
        self.rows: dict[str, TaskRow] = {}
        """By task, in the order in which they began."""
        self._units = units
        self.started_at = 0.0
        """Seconds since 1970; 0 before it has begun."""
        self.elapsed_s = 0.0
        """How long it took; 0 while it goes on."""
        self._faults: list[_Fault] = []
        self._times_done: dict[str, int] = {}
        self._printed: tuple[str, ...] = ()
        """The decision and the order of the candidates that was printed last."""

    def take(self, told: Told) -> list[str]:
        """Take in what was told; what people should read of it."""
        if not isinstance(told, FaultTold) and told.run_id != self.run_id:
            return []
        match told:
            case RunTold():
                lines = self._run(told)
            case StepTold():
                lines = self._step(told)
            case FaultTold():
                lines = self._of_fault(told)
            case DecisionTold():
                lines = self._decision(told)
        return lines

    def catch_up(self, info: RunInfo, decisions: Iterable[DecisionInfo], now: float) -> list[str]:
        """Take in how the run stands, where it was not told; what people should read of it.

        Args:
            info: the run, as its nodes show it.
            decisions: those of the server, of this run and of others; what each criterion was worth they do not show.
            now: seconds since 1970: what happened unseen gets this time.
        """
        begun = None if info.started is None else datetime.fromisoformat(info.started).timestamp()
        self.started_at = self.started_at or begun or now
        lines: list[str] = []
        for task, robot, skill, state in zip(info.tasks, info.robots, info.skills, info.states, strict=True):
            row = self.rows.get(task)
            if robot and (row is None or row.robot != robot):
                row = self.rows[task] = TaskRow(task, robot, skill, "running", self._time(now))
                lines.append(self._line(now, robot, f"is at {task}"))
            if row is not None and state in _TASK_ENDS and row.state != state:
                row.state, row.ended_s = state, self._time(now)
                if state == "done":
                    self._times_done[task] = self._times_done.get(task, 0) + 1
                lines.append(self._line(now, robot, f"{task} is {state}"))
        for decision in decisions:
            if decision.decision_id.startswith(f"{self.run_id}.") and decision.state == "chosen":
                lines += self._catch_up_with(decision, now)
        if info.is_over and self.outcome is None:
            lines += self._end(info.state, info.reason, now)
        return lines

    def _catch_up_with(self, decision: DecisionInfo, now: float) -> list[str]:
        if any((fault.robot, fault.task) == (decision.failed, decision.task) for fault in self._faults):
            return []
        ranked = [RankedRobot(*place, (), ()) for place in zip(decision.robots, decision.scores, strict=True)]
        excluded = tuple(zip(decision.excluded, decision.reasons, strict=True))
        ranking = RankingInfo((), (), decision.consistency_ratio, tuple(ranked), excluded)
        at_s = self._time(now)
        self._faults.append(_Fault(decision.failed, at_s, decision.task, decision.chosen, at_s, ranking))
        chosen = f"{decision.chosen} has taken over {decision.task} from {decision.failed}"
        return [self._line(now, "resilience", f"{chosen}, chosen by {decision.chosen_by}")]

    @property
    def problems(self) -> list[str]:
        """Why not all tasks were done, each once; empty where they were."""
        if self.outcome != "done":
            return [f"the run has not succeeded: {self.outcome}" + (f": {self.reason}" if self.reason else "")]
        found = [f"{task} was done {count} times" for task, count in self._times_done.items() if count != 1]
        if len(self._times_done) != self._tasks:
            found.append(f"{len(self._times_done)} of {self._tasks} tasks were done")
        return found

    def report(self) -> dict[str, Any]:
        """Tasks and fault as they are written to a file."""
        return {
            "tasks": [asdict(row) for row in self.rows.values()],
            "fault": None if self._fault is None else _fault_report(self._fault),
        }

    @property
    def _fault(self) -> _Fault | None:
        """The fault that led to a replacement; where there was none, the first."""
        replaced = [fault for fault in self._faults if fault.replacement is not None]
        return next(iter((*replaced, *self._faults)), None)

    def _time(self, at: float) -> float:
        """0 before the run has begun."""
        if not self.started_at:
            return 0.0
        return round(max(at - self.started_at, 0.0) * self.speed, 3)

    def _line(self, at: float, who: str, what: str) -> str:
        return f"{self._time(at):7.2f} s  {who:<18} {what}"

    def _run(self, told: RunTold) -> list[str]:
        self.started_at = self.started_at or told.at
        if told.state not in _ENDS:
            return []
        return self._end(told.state, told.message.partition(f": {told.state}: ")[2], told.at)

    def _end(self, outcome: str, reason: str, at: float) -> list[str]:
        self.outcome, self.reason, self.elapsed_s = outcome, reason, self._time(at)
        return [self._line(at, "scenario", f"{outcome}{f': {reason}' if reason else ''}")]

    def _step(self, told: StepTold) -> list[str]:
        at = told.at
        match told.fact:
            case "TaskAssigned":
                self.rows[told.task] = TaskRow(told.task, told.robot, told.skill, "running", self._time(at))
                arguments = ", ".join(f"{name} {value}" for name, value in told.detail["arguments"].items())
                return [self._line(at, told.robot, f"begins {told.task}" + (f" ({arguments})" if arguments else ""))]
            case "TaskOver":
                return self._over(told, at)
            case "BranchTaken":
                warm = "it is warmer than the limit" if told.detail["then"] else "it is not warmer than the limit"
                return [self._line(at, "scenario", f"{warm} at UR3")]
            case "RobotReturned":
                return [self._line(at, told.robot, "takes its later tasks back")]
            case _:
                return []

    def _over(self, told: StepTold, at: float) -> list[str]:
        row = self.rows[told.task]
        row.state, row.ended_s = told.outcome, self._time(at)
        if told.outcome == "done":
            self._times_done[told.task] = self._times_done.get(told.task, 0) + 1
            results = ", ".join(f"{name} {_short(value)}" for name, value in told.detail["results"].items())
            return [self._line(at, told.robot, f"has done {told.task}" + (f" ({results})" if results else ""))]
        reason = told.detail.get("message", "")
        return [
            self._line(at, told.robot, f"has not done {told.task}: {told.outcome}{f', {reason}' if reason else ''}")
        ]

    def _of_fault(self, told: FaultTold) -> list[str]:
        if told.acknowledged and told.active:
            return [self._line(told.at, told.robot, "its fault was seen by somebody")]
        if not told.active:
            return [self._line(told.at, told.robot, f"is repaired (it was: {told.reason})")]
        if self.started_at:
            self._faults.append(_Fault(told.robot, self._time(told.at)))
        lost = f", not {', not '.join(told.capacities)} any more" if told.capacities else ""
        return [self._line(told.at, told.robot, f"FAULT{lost}: {told.reason}")]

    def _decision(self, told: DecisionTold) -> list[str]:
        if told.state == "open":
            order = (told.decision_id, *(place.robot for place in told.ranking.ranked))
            if order == self._printed:
                return []
            self._printed = order
            asked = f"who takes over {told.task} from {told.failed or 'nobody'}?"
            return [self._line(told.at, "resilience", asked), *ranking_lines(told.ranking, self._units)]
        if told.state == "aborted":
            return [self._line(told.at, "resilience", f"nobody takes over {told.task}: {told.reason}")]
        open_faults = [fault for fault in self._faults if fault.replacement is None and fault.robot == told.failed]
        for fault in open_faults[-1:]:
            fault.task, fault.replacement, fault.ranking = told.task, told.chosen, told.ranking
            fault.decided_s = self._time(told.at)
        chosen = f"{told.chosen} takes over {told.task}, chosen by {told.chosen_by}"
        return [self._line(told.at, "resilience", chosen)]


def ranking_lines(ranking: RankingInfo, units: Mapping[str, str]) -> list[str]:
    """A ranking with its reasons, for people: weights, and of each candidate the raw values and what they are worth."""
    names = [f"{name} [{units[name]}]" if units.get(name) else name for name in ranking.criteria]
    rows = [["", *names, "score"]]
    rows.append(["weight", *(f"{weight:.3f}" for weight in ranking.weights), ""])
    for place in ranking.ranked:
        worth = [f"{_short(raw)} -> {score:.3f}" for raw, score in zip(place.raw, place.scores, strict=True)]
        rows.append([place.robot, *worth, f"{place.score:.3f}"])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines.append(f"consistency ratio of the judgements: {ranking.consistency_ratio:.3f} (at most 0.1)")
    lines += [f"{place.robot}: {text}" for place in ranking.ranked for text in place.missing if text]
    lines += [f"no candidate: {robot} {reason}" for robot, reason in ranking.excluded]
    return [f"{'':11}{line}" for line in lines]


def _fault_report(fault: _Fault) -> dict[str, Any]:
    ranking = fault.ranking or _NO_RANKING
    return {
        "robot": fault.robot,
        "task": fault.task,
        "detected_s": fault.detected_s,
        "replacement": fault.replacement,
        "decided_s": fault.decided_s,
        "ranking": [
            {
                "robot": place.robot,
                "score": place.score,
                "per_criterion": dict(zip(ranking.criteria, place.scores, strict=True)),
            }
            for place in ranking.ranked
        ],
        "consistency_ratio": ranking.consistency_ratio,
    }


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
