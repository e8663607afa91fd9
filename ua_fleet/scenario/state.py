"""The state of a run, as its facts make it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Final

from ua_fleet.scenario.expression import Value
from ua_fleet.scenario.facts import (
    AdoptionTold,
    BranchTaken,
    EventSeen,
    Fact,
    IterationStarted,
    OutsideTold,
    Replaced,
    ReplacementWanted,
    RobotReturned,
    RunAdopted,
    RunCarried,
    RunClosing,
    RunCreated,
    RunEnded,
    RunOutcome,
    RunPaused,
    RunResumed,
    StandInTold,
    StepEnded,
    StepStarted,
    StepState,
    TaskAccepted,
    TaskAnswered,
    TaskAssigned,
    TaskFound,
    TaskHalting,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.scenario.stand_ins import StandIns, take_stand_in

__all__ = ["RunState", "TaskPhase", "TaskRun"]

MOST_TASKS: Final = 500
"""Tasks of iterations that are over and still known; of twice as many the older half is forgotten."""

_EXCLUDED: Final = {
    TaskOutcome.REFUSED: "has refused it",
    TaskOutcome.BUSY: "was at something else",
    TaskOutcome.UNREACHED: "was not reached",
    TaskOutcome.FAILED: "failed at it",
    TaskOutcome.TIMED_OUT: "took too long for it",
    TaskOutcome.UNKNOWN: "may still be at it",
}
"""Why a robot is not asked for this task again; one that is repaired is."""
_NOT_BEGUN: Final = (TaskOutcome.BUSY, TaskOutcome.UNREACHED)
_BLAMED: Final = (TaskOutcome.FAILED, TaskOutcome.TIMED_OUT)


class TaskPhase(Enum):
    """Where a task stands between its turn and its end."""

    WANTED = auto()
    """It waits for its robot."""
    ASSIGNED = auto()
    ACCEPTED = auto()
    HALTING = auto()
    """Its robot was told to stop, and has not said that it has."""
    REPLACING = auto()
    """A replacement is looked for."""
    ASKED = auto()
    """Nobody knows what its robot is at; a person is asked."""
    LOST = auto()
    """Nobody knows what its robot is at; the robot is waited for."""
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
    executed_by: str = ""
    """The robot of that execution; another one is looked for, or was found, where `robot` is not the same."""
    execution_before: str = ""
    """The one before it: its robot may still tell that it was done."""
    skill: str = ""
    arguments: Mapping[str, Value] = field(default_factory=dict[str, Value])
    assigned_at: float = 0.0
    reason: str = ""
    """Why a replacement is wanted, or what is known where an operator is asked."""
    halting: TaskHalting | None = None
    """What it was told to stop for; kept while nobody knows whether it has."""
    lost_since: float | None = None
    """Since when nobody knows what its robot is at, and it is waited for."""
    is_agreed: bool = False
    """Whether a person has agreed to that the robot does it once more, though nobody knows what it is at."""
    excluded: dict[str, str] = field(default_factory=dict[str, str])
    """Robots that are not asked for this task again, with the reason."""
    said: dict[str, str] = field(default_factory=dict[str, str])
    """What each robot that did not do it said."""
    failed_on: dict[str, str] = field(default_factory=dict[str, str])
    """What robots said that began it and failed at it."""
    is_own: bool = False
    """Whether its robot has it though another one, which only failed at this task, is to do the later ones."""


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
    stand_ins: StandIns = field(default_factory=dict[str, dict[str, str]])
    events_seen: set[str] = field(default_factory=set[str])
    first_failure: str = ""
    paused: bool = False
    closing: RunClosing | None = None
    carried: tuple[int, ...] = ()
    """The spaces of the bridges that carry the run; none: the server does it."""
    untold: tuple[int, ...] = ()
    """Those of bridges that are off, without which the run ends."""
    outside: dict[str, bool] = field(default_factory=dict[str, bool])
    """Whether tasks of other branches, which other parts of a carried run do, are done; False: they will not be."""
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

    def stand_in_for(self, robot: str, needs: Callable[[str], Collection[str]]) -> str:
        """Who does what a robot is to do: itself, or the last of those that stand in for each other.

        Args:
            robot: the robot.
            needs: the capacities that this needs on a robot.
        """
        seen: set[str] = set()
        while robot not in seen and (by_capacity := self.stand_ins.get(robot)) is not None:
            stand_in = next((by_capacity[name] for name in ("", *needs(robot)) if name in by_capacity), None)
            if stand_in is None:
                break
            seen.add(robot)
            robot = stand_in
        return robot

    def in_phase(self, *phases: TaskPhase) -> list[str]:
        """The steps of the tasks that stand there."""
        return [step for step, task_run in self.tasks.items() if task_run.phase in phases]

    def apply(self, fact: Fact) -> None:
        """Take a fact in."""
        match fact:
            case RunCreated():
                self.run_id, self.parameters, self.by = fact.run_id, dict(fact.parameters), fact.by
            case RunCarried():
                self.carried = tuple(fact.spaces)
            case RunAdopted():
                self.carried = tuple([space for space in self.carried if space != fact.space])
                self.untold += () if fact.heir else (fact.space,)
            case AdoptionTold():
                pass
            case StepStarted():
                self.started[fact.step] = fact.at
            case BranchTaken():
                self.branches[fact.step] = fact.then
            case IterationStarted():
                self.iterations[fact.step] = fact.number
                self._forget_iteration(fact.step, fact.number - 1)
            case OutsideTold():
                self._outside_told(fact)
            case EventSeen():
                self.events_seen.add(fact.step)
                self.waiting_for_events.pop(fact.step, None)
            case StepEnded():
                self._step_ended(fact)
            case RobotReturned() | StandInTold():
                take_stand_in(self.stand_ins, fact)
            case RunPaused() | RunResumed():
                self.paused = isinstance(fact, RunPaused)
            case RunClosing():
                self.closing = fact
            case RunEnded():
                self.outcome, self.reason = fact.outcome, fact.reason
            case _:
                self._task_changed(fact)

    def _outside_told(self, fact: OutsideTold) -> None:
        if fact.is_done:
            self.outside[fact.task] = True
            self.results[fact.task] = fact.results
        else:
            self.outside.setdefault(fact.task, False)

    def _forget_iteration(self, repeat: str, number: int) -> None:
        """What was within an iteration is never looked at again, but for the last tasks, which people see.

        Of iterations before it something may have become known since, where several bridges carry the run.
        """
        base, at, scope = repeat.partition("@")
        body, within = f"{base}.repeat", f"{at}{scope}@"

        def is_gone(key: str) -> bool:
            step, sign, rest = key.partition("@")
            if not (step.startswith(body) and f"{sign}{rest}".startswith(within)):
                return False
            return int(f"{sign}{rest}"[len(within) :].partition("@")[0]) <= number

        def forget(keys: Iterable[str]) -> None:
            for key in keys:
                for known in (self.started, self.ended, self.branches, self.iterations, self.undecided):
                    known.pop(key, None)
                self.waiting_for_events.pop(key, None)
                self.events_seen.discard(key)

        self.tasks_done = {key for key in self.tasks_done if not is_gone(key)}
        gone = [key for key in self.started if key not in self.gone_tasks and is_gone(key)]
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
        self,
        fact: TaskAssigned
        | TaskAccepted
        | TaskHalting
        | TaskFound
        | TaskOver
        | TaskAnswered
        | ReplacementWanted
        | Replaced,
    ) -> None:
        task = self.tasks.setdefault(fact.step, TaskRun())
        match fact:
            case TaskAssigned():
                task.tries = task.tries + 1 if task.robot == fact.robot else 1
                task.name, task.attempt, task.robot = fact.task, fact.attempt, fact.robot
                task.execution_before, task.execution_id = task.execution_id, fact.execution_id
                task.executed_by, task.skill, task.arguments = fact.robot, fact.skill, fact.arguments
                task.assigned_at, task.phase, task.halting = fact.at, TaskPhase.ASSIGNED, None
                task.lost_since, task.is_agreed = None, False
                self.executions[fact.execution_id] = fact.step
            case TaskAccepted() | TaskFound():
                task.phase, task.halting = TaskPhase.ACCEPTED, None
                task.lost_since, task.is_agreed = None, False
            case TaskHalting():
                task.phase, task.halting = TaskPhase.HALTING, fact
            case TaskOver():
                self._attempt_over(task, fact)
                self._follow(fact.step, task, fact.then)
            case TaskAnswered():
                if fact.then is Then.REPLACE:
                    task.excluded[task.robot] = _EXCLUDED[TaskOutcome.UNKNOWN]
                elif fact.then is Then.AWAIT:
                    task.lost_since, task.is_agreed = fact.at, True
                self._follow(fact.step, task, fact.then)
            case ReplacementWanted():
                task.name, task.skill = fact.task or task.name, fact.skill or task.skill
                task.phase, task.reason, task.robot = TaskPhase.REPLACING, fact.reason, fact.robot
                if fact.robot:
                    task.said[fact.robot] = fact.reason
            case Replaced():
                self._replaced(task, fact)

    def _attempt_over(self, task: TaskRun, fact: TaskOver) -> None:
        was_begun = task.phase is not TaskPhase.ASSIGNED
        task.reason = fact.message
        if fact.then not in (Then.ASK, Then.AWAIT):
            task.halting = None
        if fact.then is not Then.AWAIT:
            task.lost_since, task.is_agreed = None, False
        elif task.lost_since is None:
            task.lost_since = fact.at
        if fact.outcome in _NOT_BEGUN:
            task.tries -= 1
            task.busy_since = task.assigned_at if task.busy_since is None else task.busy_since
        else:
            task.busy_since = None
        if fact.then is Then.DONE:
            self.results[task.name] = fact.results
            return
        task.said[task.robot] = fact.message
        if was_begun and fact.outcome in _BLAMED:
            task.failed_on[task.robot] = fact.message
        if fact.then is Then.REPLACE and fact.outcome in _EXCLUDED:
            task.excluded[task.robot] = _EXCLUDED[fact.outcome]

    def _replaced(self, task: TaskRun, fact: Replaced) -> None:
        if task.phase is TaskPhase.ASKED:
            task.excluded[fact.failed] = _EXCLUDED[TaskOutcome.UNKNOWN]
        task.phase, task.tries, task.robot = TaskPhase.WANTED, 0, fact.robot
        task.busy_since = None  # that was another robot
        if fact.failed != fact.robot and not fact.lasting:
            task.is_own = True
        take_stand_in(self.stand_ins, fact)

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
            case Then.AWAIT:
                task.phase = TaskPhase.LOST
            case Then.REPLACE:
                task.phase = TaskPhase.REPLACING
