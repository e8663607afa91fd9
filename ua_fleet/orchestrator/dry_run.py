"""What a run would come to if every robot did at once what it is asked: the orchestrator itself, in virtual time.

given values   robots' values (`ur3.temperature`) and results of tasks (`fetch.weight`); results that are not given
               are 0, false or empty, and values that are not given those of now
robots         have no faults and nothing else to do; who gets a task is found as in a run; what was begun first ends
               first
events         happen as soon as they are waited for
time           passes at once, so that waits and timeouts are seen with their times
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from ua_fleet.orchestrator.candidates import ResilienceSettings
from ua_fleet.orchestrator.orchestrator import Orchestrator
from ua_fleet.orchestrator.outputs import Output, RunChanged, TaskStarted
from ua_fleet.resilience import DecisionMode
from ua_fleet.scenario import FleetView, Lookup, Scenario, Value, ValueUnknown
from ua_fleet.scenario.facts import (
    BranchTaken,
    EventSeen,
    Fact,
    IterationStarted,
    RunEnded,
    RunOutcome,
    StepEnded,
    StepState,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
)
from ua_fleet.values import BuiltinType

__all__ = ["MOST_MOMENTS", "DryRun", "DryRunMoment", "dry_run"]

MOST_MOMENTS: Final = 10_000
"""A run that comes to more is cut off: it may never end."""

_RUN: Final = "dry-run"


@dataclass(frozen=True, slots=True)
class DryRunMoment:
    """Something that would happen."""

    at: float
    """Seconds since the start of the run."""
    step: str
    text: str


@dataclass(frozen=True, slots=True)
class DryRun:
    """What a run would come to."""

    outcome: RunOutcome | None
    """None where it would not end: something is waited for that nobody gave, or it is too long."""
    reason: str
    timeline: tuple[DryRunMoment, ...]


def dry_run(
    scenario: Scenario,
    fleet: FleetView,
    settings: ResilienceSettings,
    parameters: Mapping[str, Value] | None = None,
    values: Mapping[str, Value] | None = None,
    *,
    lookup: Lookup | None = None,
) -> DryRun:
    """Run a validated scenario without robots.

    Args:
        scenario: which.
        fleet: the robots.
        settings: how a robot is found for a task that any may do.
        parameters: of the scenario.
        values: of robots, and results of tasks.
        lookup: values of robots that are not given; None: they are not known.

    Raises:
        ScenarioError: a parameter that is missing, unknown, of another kind or out of its range.
    """
    return _Rehearsal(fleet, settings, values or {}, lookup).of(scenario, parameters or {})


class _Rehearsal:
    def __init__(
        self, fleet: FleetView, settings: ResilienceSettings, values: Mapping[str, Value], lookup: Lookup | None
    ) -> None:
        self._fleet, self._values, self._now_known = fleet, values, lookup
        self._timeline: list[DryRunMoment] = []
        self._outcome: RunOutcome | None = None
        self._reason = ""
        self._now = 0.0
        self._facts = 0
        self._begun: deque[TaskStarted] = deque()
        nobody_is_asked = replace(settings, mode=DecisionMode.AUTOMATIC)
        self._orchestrator = Orchestrator(nobody_is_asked, fleet, self._lookup, self._count)

    def of(self, scenario: Scenario, parameters: Mapping[str, Value]) -> DryRun:
        """Rehearse a scenario."""
        orchestrator = self._orchestrator
        self._take(orchestrator.start(_RUN, scenario, parameters, by="dry run", now=self._now))
        while self._outcome is None and self._facts <= MOST_MOMENTS:
            if self._begun:
                self._do(self._begun.popleft())
                continue
            waiting = sorted(set(orchestrator.runs[_RUN].state.waiting_for_events.values()))
            deadline = orchestrator.next_deadline()
            if waiting:
                self._take(orchestrator.event(waiting[0], self._now))
            elif deadline is not None:
                self._now = max(self._now, deadline)
            else:
                self._reason = "it would wait for ever: for a condition on values that do not change here"
                break
            self._take(orchestrator.poll(self._now))
        if self._outcome is None and not self._reason:
            self._reason = f"it was cut off after {MOST_MOMENTS} steps: it may never end"
        return DryRun(self._outcome, self._reason, tuple(self._timeline))

    def _count(self, run_id: str, fact: Fact) -> None:
        del run_id, fact
        self._facts += 1

    def _lookup(self, name: str) -> Value:
        value = self._values.get(name)
        if value is not None:
            return value
        if self._now_known is not None:
            return self._now_known(name)
        raise ValueUnknown(f"no value is given for {name}")

    def _do(self, task: TaskStarted) -> None:
        self._take(self._orchestrator.accepted(task.execution_id, self._now))
        done = self._orchestrator.ended(task.execution_id, TaskOutcome.DONE, self._now, results=self._results(task))
        self._take(done)

    def _take(self, outputs: Sequence[Output]) -> None:
        for output in outputs:
            if isinstance(output, TaskStarted):
                self._begun.append(output)
            elif isinstance(output, RunChanged):
                self._tell(output.fact)

    def _results(self, task: TaskStarted) -> dict[str, Value]:
        skill = self._fleet.declared(task.robot, task.skill)
        declared = skill.results if skill is not None else ()
        return {
            result.name: self._values.get(f"{task.task}.{result.name}", _nothing(result.type)) for result in declared
        }

    def _tell(self, fact: Fact) -> None:
        text = _said(fact)
        if text:
            self._timeline.append(DryRunMoment(fact.at, getattr(fact, "step", ""), text))
        if isinstance(fact, RunEnded):
            self._outcome, self._reason = fact.outcome, fact.reason


def _nothing(kind: int) -> Value:
    if kind == BuiltinType.BOOLEAN:
        return False
    if kind == BuiltinType.STRING:
        return ""
    return 0.0 if kind in (BuiltinType.FLOAT, BuiltinType.DOUBLE) else 0


def _said(fact: Fact) -> str:
    """A fact for people; empty for what only moves the engine."""
    match fact:
        case TaskAssigned():
            arguments = ", ".join(f"{name}={value}" for name, value in fact.arguments.items())
            return f"{fact.task}: {fact.robot} {fact.skill}({arguments})"
        case TaskOver():
            return fact.outcome.value
        case BranchTaken():
            return "the condition holds" if fact.then else "the condition does not hold"
        case IterationStarted():
            return f"repetition {fact.number + 1}"
        case EventSeen():
            return f"event {fact.event}"
        case StepEnded(state=StepState.FAILED) if fact.reason:
            return fact.reason
        case RunEnded():
            return f"the run is {fact.outcome.value}"
        case _:
            return ""
