"""The state of a run, as its facts make it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Final

from ua_fleet.scenario.expression import Value
from ua_fleet.scenario.facts import (
    BranchTaken,
    EventSeen,
    Fact,
    IterationStarted,
    Replaced,
    ReplacementWanted,
    RobotReturned,
    RunClosing,
    RunCreated,
    RunEnded,
    RunOutcome,
    RunPaused,
    RunResumed,
    StepEnded,
    StepStarted,
    StepState,
    TaskAccepted,
    TaskAnswered,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.scenario.model import OnUnknown, Task

__all__ = ["RunState", "TaskPhase", "TaskRun"]

BUSY_S: Final = 10.0
"""So long a robot that is at something else is asked again; then it has refused."""
MOST_TASKS: Final = 500
"""Tasks of iterations that are over and still known; of twice as many the older half is forgotten."""

_AFTER_UNKNOWN: Final = {OnUnknown.ASK: Then.ASK, OnUnknown.RETRY: Then.RETRY, OnUnknown.FAIL: Then.REPLACE}


class TaskPhase(Enum):
    """Where a task stands between its turn and its end."""

    WANTED = auto()
    """It waits for its robot."""
    ASSIGNED = auto()
    ACCEPTED = auto()
    REPLACING = auto()
    """A replacement is looked for."""
    ASKED = auto()
    OVER = auto()


@dataclass(slots=True)
class TaskRun:
    """One task within a run."""

    name: str = ""
    phase: TaskPhase = TaskPhase.WANTED
    attempt: int = 0
    """Numbers all attempts of the task, on whatever robot."""
    tries: int = 0
    """Attempts on this robot, without those for which it was busy."""
    busy_since: float | None = None
    """When it was first asked for this attempt, and was at something else."""
    robot: str = ""
    execution_id: str = ""
    skill: str = ""
    arguments: Mapping[str, Value] = field(default_factory=dict[str, Value])
    assigned_at: float = 0.0
    reason: str = ""
    """Why a replacement is wanted, or what is known where an operator is asked."""
    refused_by: tuple[str, ...] = ()
    """Robots that would not even begin it; nobody asks them again."""

    def then(self, task: Task, outcome: TaskOutcome, now: float, *, is_closing: bool) -> Then:
        """What follows from how the attempt has ended; a run that is closing begins nothing more."""
        if outcome is TaskOutcome.DONE:
            return Then.DONE
        if is_closing:
            return Then.FAILED
        if outcome is TaskOutcome.UNKNOWN:
            return _AFTER_UNKNOWN[task.on_unknown]
        if outcome is TaskOutcome.BUSY:
            since = self.assigned_at if self.busy_since is None else self.busy_since
            return Then.RETRY if now < since + BUSY_S else Then.REPLACE
        if outcome is not TaskOutcome.FAULT and self.tries <= task.retries:
            return Then.RETRY
        return Then.REPLACE


@dataclass(slots=True)
class RunState:
    """All that a run knows. `apply` is the only thing that changes what the journal has to bring back."""

    run_id: str = ""
    parameters: dict[str, Value] = field(default_factory=dict[str, Value])
    by: str = ""
    started: dict[str, float] = field(default_factory=dict[str, float])
    ended: dict[str, StepState] = field(default_factory=dict[str, StepState])
    branches: dict[str, bool] = field(default_factory=dict[str, bool])
    iterations: dict[str, int] = field(default_factory=dict[str, int])
    tasks: dict[str, TaskRun] = field(default_factory=dict[str, TaskRun])
    tasks_done: set[str] = field(default_factory=set[str])
    """Keys of the tasks that were done; within repetitions with the numbers of those, of all but the inmost, and so
    on to none. Of a repetition that is over only what is without its number stays."""
    executions: dict[str, str] = field(default_factory=dict[str, str])
    """The step of each execution id, those of earlier attempts included."""
    results: dict[str, Mapping[str, Value]] = field(default_factory=dict[str, Mapping[str, Value]])
    stand_ins: dict[str, str] = field(default_factory=dict[str, str])
    events_seen: set[str] = field(default_factory=set[str])
    first_failure: str = ""
    paused: bool = False
    closing: RunClosing | None = None
    outcome: RunOutcome | None = None
    reason: str = ""

    gone_tasks: dict[str, None] = field(default_factory=dict[str, None])
    """Tasks of iterations that are over, the oldest first."""
    undecided: dict[str, float] = field(default_factory=dict[str, float])
    """Since when a condition waits for its values; begins anew after a restart."""
    waiting_for_events: dict[str, str] = field(default_factory=dict[str, str])

    def phase(self, step: str) -> TaskPhase | None:
        """Where a task stands; None before its turn."""
        task_run = self.tasks.get(step)
        return None if task_run is None else task_run.phase

    def stand_in_for(self, robot: str) -> str:
        """Who does what a robot is to do: itself, or the last of those that stand in for each other."""
        seen: set[str] = set()
        while robot in self.stand_ins and robot not in seen:
            seen.add(robot)
            robot = self.stand_ins[robot]
        return robot

    def in_phase(self, *phases: TaskPhase) -> list[str]:
        """The steps of the tasks that stand there."""
        return [step for step, task_run in self.tasks.items() if task_run.phase in phases]

    def apply(self, fact: Fact) -> None:
        """Take a fact in."""
        match fact:
            case RunCreated():
                self.run_id, self.parameters, self.by = fact.run_id, dict(fact.parameters), fact.by
            case StepStarted():
                self.started[fact.step] = fact.at
            case BranchTaken():
                self.branches[fact.step] = fact.then
            case IterationStarted():
                self.iterations[fact.step] = fact.number
                self._forget_iteration(fact.step, fact.number - 1)
            case EventSeen():
                self.events_seen.add(fact.step)
                self.waiting_for_events.pop(fact.step, None)
            case StepEnded():
                self._step_ended(fact)
            case RobotReturned():
                self.stand_ins.pop(fact.robot, None)
            case RunPaused():
                self.paused = True
            case RunResumed():
                self.paused = False
            case RunClosing():
                self.closing = fact
            case RunEnded():
                self.outcome, self.reason = fact.outcome, fact.reason
            case _:
                self._task_changed(fact)

    def _forget_iteration(self, repeat: str, number: int) -> None:
        """What was within an iteration is never looked at again, but for the last tasks, which people see."""
        base, at, scope = repeat.partition("@")
        body, within = f"{base}.repeat", f"{at}{scope}@{number}"

        def is_gone(key: str) -> bool:
            step, sign, rest = key.partition("@")
            return step.startswith(body) and f"{sign}{rest}@".startswith(f"{within}@")

        def forget(keys: Iterable[str]) -> None:
            for key in keys:
                for known in (self.started, self.ended, self.branches, self.iterations, self.undecided):
                    known.pop(key, None)
                self.waiting_for_events.pop(key, None)
                self.events_seen.discard(key)

        self.tasks_done = {key for key in self.tasks_done if not is_gone(key)}
        gone = [key for key in self.started if is_gone(key)]
        forget([key for key in gone if key not in self.tasks])
        self.gone_tasks.update(dict.fromkeys([key for key in gone if key in self.tasks]))
        if len(self.gone_tasks) >= 2 * MOST_TASKS:
            forgotten = list(self.gone_tasks)[:-MOST_TASKS]
            for key in forgotten:
                del self.tasks[key], self.gone_tasks[key]
            self.executions = {known: step for known, step in self.executions.items() if step in self.tasks}
            forget(forgotten)

    def _step_ended(self, fact: StepEnded) -> None:
        self.waiting_for_events.pop(fact.step, None)
        task = self.tasks.get(fact.step)
        if task is not None:
            self._end_task(fact.step, task, fact.state, fact.reason)
        else:
            self._end(fact.step, fact.state, fact.reason)

    def _end(self, step: str, state: StepState, reason: str) -> None:
        self.ended[step] = state
        if state is StepState.FAILED and reason and not self.first_failure:
            self.first_failure = reason

    def _end_task(self, step: str, task: TaskRun, state: StepState, reason: str) -> None:
        task.phase = TaskPhase.OVER
        if state is StepState.DONE:
            key, *numbers = step.split("@")
            self.tasks_done.update("@".join((key, *numbers[:depth])) for depth in range(len(numbers) + 1))
        self._end(step, state, reason)

    def _task_changed(
        self, fact: TaskAssigned | TaskAccepted | TaskOver | TaskAnswered | ReplacementWanted | Replaced
    ) -> None:
        task = self.tasks.setdefault(fact.step, TaskRun())
        match fact:
            case TaskAssigned():
                task.tries = task.tries + 1 if task.robot == fact.robot else 1
                task.name, task.attempt, task.robot = fact.task, fact.attempt, fact.robot
                task.execution_id, task.skill, task.arguments = fact.execution_id, fact.skill, fact.arguments
                task.assigned_at, task.phase = fact.at, TaskPhase.ASSIGNED
                self.executions[fact.execution_id] = fact.step
            case TaskAccepted():
                task.phase = TaskPhase.ACCEPTED
            case TaskOver():
                task.reason = fact.message
                is_busy = fact.outcome is TaskOutcome.BUSY
                if fact.outcome is TaskOutcome.REFUSED or (is_busy and fact.then is Then.REPLACE):
                    task.refused_by = (*task.refused_by, task.robot)
                if not is_busy:
                    task.busy_since = None
                else:
                    task.tries -= 1
                    task.busy_since = task.assigned_at if task.busy_since is None else task.busy_since
                if fact.then is Then.DONE:
                    self.results[task.name] = fact.results
                self._follow(fact.step, task, fact.then)
            case TaskAnswered():
                self._follow(fact.step, task, fact.then)
            case ReplacementWanted():
                task.name, task.skill = fact.task or task.name, fact.skill or task.skill
                task.phase, task.reason, task.robot = TaskPhase.REPLACING, fact.reason, fact.robot
            case Replaced():
                task.phase, task.tries, task.robot = TaskPhase.WANTED, 0, fact.robot
                if fact.failed == fact.robot:  # it was repaired before anybody had taken over
                    self.stand_ins.pop(fact.failed, None)
                elif fact.failed:
                    self.stand_ins[fact.failed] = fact.robot

    def _follow(self, step: str, task: TaskRun, then: Then) -> None:
        match then:
            case Then.DONE:
                self._end_task(step, task, StepState.DONE, "")
            case Then.FAILED:
                self._end_task(step, task, StepState.FAILED, task.reason)
            case Then.RETRY:
                task.phase = TaskPhase.WANTED
            case Then.ASK:
                task.phase = TaskPhase.ASKED
            case Then.REPLACE:
                task.phase = TaskPhase.REPLACING
