"""What a run would come to if every robot did at once what it is asked: the engine itself, in virtual time.

given values   robots' values (`ur3.temperature`) and results of tasks (`fetch.weight`); results that are not given
               are 0, false or empty
events         happen as soon as they are waited for
time           passes at once, so that waits and timeouts are seen with their times
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from ua_fleet.scenario.effects import Effect, Happened, OpenDecision, StartTask, WantRobot
from ua_fleet.scenario.expression import Value, ValueUnknown
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
from ua_fleet.scenario.model import Scenario
from ua_fleet.scenario.run import Run
from ua_fleet.scenario.validate import FleetView
from ua_fleet.values import BuiltinType

__all__ = ["MOST_MOMENTS", "DryRun", "Moment", "dry_run"]

MOST_MOMENTS: Final = 10_000
"""A run that comes to more is cut off: it may never end."""


@dataclass(frozen=True, slots=True)
class Moment:
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
    timeline: tuple[Moment, ...]


def dry_run(
    scenario: Scenario,
    fleet: FleetView,
    parameters: Mapping[str, Value] | None = None,
    values: Mapping[str, Value] | None = None,
) -> DryRun:
    """Run a validated scenario without robots.

    Raises:
        ScenarioError: a parameter that is missing, unknown, of another kind or out of its range.
    """
    return _Rehearsal(scenario, fleet, parameters or {}, values or {}).result()


class _Rehearsal:
    def __init__(
        self, scenario: Scenario, fleet: FleetView, parameters: Mapping[str, Value], values: Mapping[str, Value]
    ) -> None:
        self._fleet, self._values = fleet, values
        self._timeline: list[Moment] = []
        self._outcome: RunOutcome | None = None
        self._reason = ""
        self._now = 0.0
        self._facts = 0
        self._run = Run.create("dry-run", scenario, parameters, self._count, by="dry run", now=0.0)

    def result(self) -> DryRun:
        self._take(self._run.poll(self._lookup, self._now))
        while self._outcome is None and self._facts <= MOST_MOMENTS:
            waiting = sorted(set(self._run.state.waiting_for_events.values()))
            deadline = self._run.next_deadline()
            if waiting:
                self._take(self._run.event(waiting[0], self._now))
            elif deadline is not None:
                self._now = max(self._now, deadline)
            else:
                self._reason = "it would wait for ever: for a condition on values that do not change here"
                break
            self._take(self._run.poll(self._lookup, self._now))
        if self._outcome is None and not self._reason:
            self._reason = f"it was cut off after {MOST_MOMENTS} steps: it may never end"
        return DryRun(self._outcome, self._reason, tuple(self._timeline))

    def _count(self, fact: Fact) -> None:
        del fact
        self._facts += 1

    def _lookup(self, name: str) -> Value:
        value = self._values.get(name)
        if value is None:
            raise ValueUnknown(f"no value is given for {name}")
        return value

    def _take(self, effects: list[Effect]) -> None:
        """Carry out what is asked for; a loop, since each answer asks for more."""
        waiting = list(effects)
        while waiting and self._facts <= MOST_MOMENTS:
            effect = waiting.pop(0)
            match effect:
                case Happened(fact=fact):
                    self._tell(fact)
                case WantRobot():
                    waiting += self._grant(effect)
                case StartTask():
                    results = self._results(effect)
                    waiting += self._run.accepted(effect.execution_id, self._now)
                    waiting += self._run.ended(effect.execution_id, TaskOutcome.DONE, self._now, results=results)
                case OpenDecision():
                    waiting += self._run.not_replaced(effect.step, effect.reason, self._now)
                case _:
                    pass

    def _grant(self, wanted: WantRobot) -> list[Effect]:
        robot = wanted.robot
        if robot is None:
            able = self._fleet.able(wanted.skill, wanted.capacities)
            if not able:
                return self._run.nobody(wanted.step, f"no robot can do {wanted.skill}", self._now)
            robot = able[0].name
        return self._run.granted(wanted.step, robot, self._now, self._fleet.declared(robot, wanted.skill))

    def _results(self, task: StartTask) -> dict[str, Value]:
        skill = self._fleet.declared(task.robot, task.skill)
        declared = skill.results if skill is not None else ()
        return {
            result.name: self._values.get(f"{task.task}.{result.name}", _nothing(result.type)) for result in declared
        }

    def _tell(self, fact: Fact) -> None:
        text = _said(fact)
        if text:
            self._timeline.append(Moment(fact.at, getattr(fact, "step", ""), text))
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
