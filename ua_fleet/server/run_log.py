"""Runs, faults and decisions as the log tells them, each with the ids by which a run can be followed."""

from __future__ import annotations

from collections import Counter
from typing import Any, Final

import structlog

from ua_fleet.operation.runs.finding import SILENT
from ua_fleet.orchestrator import (
    DecisionChanged,
    Fault,
    FaultChange,
    FaultChanged,
    HoldChanged,
    OperatorAsked,
    Output,
    RunChanged,
    TaskStarted,
    TaskWaiting,
)
from ua_fleet.resilience import RankingChanged, ReplacementChosen
from ua_fleet.scenario.facts import (
    Fact,
    ReplacementWanted,
    RobotReturned,
    RunEnded,
    RunOutcome,
    RunPaused,
    RunResumed,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
)

__all__ = ["RunLog"]

_log: Any = structlog.get_logger("ua_fleet.scenarios")
_MOST_OPEN: Final = 10_000


class RunLog:
    """Is told of everything that happens, in order, and says what an operator has to know."""

    def __init__(self) -> None:
        self.ended: Counter[RunOutcome] = Counter()
        """Runs that have ended since the start."""
        self._tasks: dict[tuple[str, str], dict[str, str]] = {}
        """What is under way: ids by run and step."""
        self._decisions: dict[str, str] = {}
        """Those that were told to be open, with their runs."""

    def take(self, output: Output) -> None:
        """Something has happened."""
        if isinstance(output, RunChanged):
            self._fact(output.run_id, output.fact)
        elif isinstance(output, TaskStarted):
            self._know(output.run_id, output.step, output.task, output.robot, output.skill, output.execution_id)
        elif isinstance(output, FaultChanged):
            self._fault(output.fault, output.change)
        elif isinstance(output, DecisionChanged):
            self._decision(output)
        elif isinstance(output, HoldChanged):
            hold, what = output.hold, "held from tasks" if output.is_held else "released for tasks"
            _log.info(f"robot is {what}", robot=hold.robot, by=output.by, reason=hold.reason)
        elif isinstance(output, TaskWaiting):
            waits = output.waits
            if waits.step and waits.reason:
                ids = {"step": waits.step, "task": waits.task, "robot": waits.robot, "skill": waits.skill}
                _log.info("task waits", run_id=output.run_id, **ids, reason=waits.reason)
        elif isinstance(output, OperatorAsked):
            ids = {"run_id": output.run_id, "step": output.step, "task": output.task, "robot": output.robot}
            _log.warning(
                "an operator has to say what became of a task",
                **ids,
                execution_id=output.execution_id,
                question=output.question,
            )

    def _know(self, run_id: str, step: str, task: str, robot: str, skill: str, execution_id: str) -> dict[str, str]:
        if len(self._tasks) >= _MOST_OPEN:
            del self._tasks[next(iter(self._tasks))]
        ids = {"task": task, "robot": robot, "skill": skill, "execution_id": execution_id}
        self._tasks[run_id, step] = ids
        return ids

    def _fact(self, run_id: str, fact: Fact) -> None:
        if isinstance(fact, TaskAssigned):
            ids = self._know(run_id, fact.step, fact.task, fact.robot, fact.skill, fact.execution_id)
            _log.info("task begins", run_id=run_id, step=fact.step, attempt=fact.attempt, **ids)
        elif isinstance(fact, TaskOver):
            ids = self._tasks.pop((run_id, fact.step), {})
            said = {"reason": fact.message} if fact.message else {}
            is_done = fact.outcome in (TaskOutcome.DONE, TaskOutcome.BUSY)  # who is busy is asked again
            tell = _log.info if is_done else _log.warning
            follows = {} if fact.outcome is TaskOutcome.DONE else {"then": fact.then.value}
            tell("task ended", run_id=run_id, step=fact.step, outcome=fact.outcome.value, **ids, **follows, **said)
        elif isinstance(fact, ReplacementWanted):
            _log.warning(
                "another robot is looked for", run_id=run_id, step=fact.step, robot=fact.robot, reason=fact.reason
            )
        elif isinstance(fact, RobotReturned):
            _log.info("robot takes its later tasks back", run_id=run_id, robot=fact.robot)
        elif isinstance(fact, RunPaused):
            _log.info("run paused", run_id=run_id, by=fact.by)
        elif isinstance(fact, RunResumed):
            _log.info("run resumed", run_id=run_id, by=fact.by)
        elif isinstance(fact, RunEnded):
            self.ended[fact.outcome] += 1
            tell = _log.info if fact.outcome is RunOutcome.DONE else _log.warning
            tell("run ended", run_id=run_id, outcome=fact.outcome.value, reason=fact.reason)
            self._tasks = {key: ids for key, ids in self._tasks.items() if key[0] != run_id}
            self._decisions = {decision: run for decision, run in self._decisions.items() if run != run_id}

    def _fault(self, fault: Fault, change: FaultChange) -> None:
        if fault.source == SILENT:
            return  # the fleet's state says so already
        ids = {"robot": fault.robot, "source": fault.source}
        if change is FaultChange.RAISED:
            _log.warning("robot has a fault", **ids, reason=fault.reason)
        elif change is FaultChange.CLEARED:
            _log.info("fault is over", **ids)

    def _decision(self, change: DecisionChanged) -> None:
        event, ids = change.event, {"run_id": change.run_id, "step": change.step, "task": change.task}
        if isinstance(event, RankingChanged):
            if event.decision_id not in self._decisions:
                self._decisions[event.decision_id] = change.run_id
                _log.warning(
                    "a replacement has to be chosen",
                    **ids,
                    robot=change.failed,
                    reason=change.reason,
                    decision_id=event.decision_id,
                )
            return
        self._decisions.pop(event.decision_id, None)
        if isinstance(event, ReplacementChosen):
            _log.info(
                "replacement chosen",
                **ids,
                robot=event.robot,
                instead_of=change.failed,
                by=event.by,
                decision_id=event.decision_id,
            )
        else:
            _log.warning(
                "no replacement", **ids, robot=change.failed, reason=event.reason, decision_id=event.decision_id
            )
