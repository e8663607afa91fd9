"""One run of a scenario: a pure engine. Inputs are facts of the world with their time; outputs are effects.

What a run decides is first journaled as a fact, then applied, then its effects are returned. So a process that is
killed at any moment builds the same state from the journal and asks for the same effects again, which do no harm twice:
a task's execution id follows from the run, the step and the attempt.

    task:  waits for `after`, then for its robot --granted--> assigned --accepted--> accepted --done--> over
           assigned, accepted --failed, refused, timed out--> once more while retries are left, then a replacement
                              --busy--> asked again for a while, then a replacement
                              --robot's fault--> a replacement is wanted
                              --unknown--> by `on_unknown`: asked, once more, or a replacement
           replacement wanted --replaced--> waits for that robot
                              --not replaced--> failed, and with it the run
           asked --answered--> done, once more, or a replacement

A paused run starts no task; what robots are at goes on. A run that is aborted cancels it, and ends when all is over.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.scenario.asking import asked_for
from ua_fleet.scenario.effects import CancelTask, Effect, Happened, ReleaseRobot
from ua_fleet.scenario.expression import Lookup, Value, ValueUnknown
from ua_fleet.scenario.facts import (
    EventSeen,
    Fact,
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
    StepState,
    TaskAccepted,
    TaskAnswered,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.scenario.model import Scenario, Task
from ua_fleet.scenario.order import Order, ahead
from ua_fleet.scenario.parameters import arguments_for, checked_parameters
from ua_fleet.scenario.state import RunState, TaskPhase, TaskRun
from ua_fleet.scenario.walk import Moment, Walk

__all__ = ["ANSWERS", "Journal", "Run"]

Journal = Callable[[Fact], None]
"""Writes a fact down; when it returns the fact is there after a crash."""

ANSWERS: Final = {"done": Then.DONE, "retry": Then.RETRY, "fail": Then.REPLACE}
"""What an operator may say of a task of which nobody can tell whether it was done."""
CLOSING_GRACE_S: Final = 10.0
"""A run that is to end waits so long for what robots are at."""

_NAMESPACE: Final = uuid.UUID("6f2c4f0e-4f6c-5d0e-9a57-0b8c5d3f7a11")
_ACTIVE: Final = (TaskPhase.ASSIGNED, TaskPhase.ACCEPTED)
_ANSWERABLE: Final = (*_ACTIVE, TaskPhase.ASKED)


class Run:
    """A run. Every method that takes something in returns the effects to carry out, in order."""

    def __init__(self, scenario: Scenario, state: RunState, journal: Journal) -> None:
        """Use `create` for a new run and `restore` for one of the journal."""
        self._scenario, self._journal, self.state = scenario, journal, state
        self._tasks = {task.key: task for task in scenario.tasks()}
        self._order = Order(self._tasks.values())
        self._faulted: dict[str, str] = {}
        """Robots that cannot work now, with the reason."""
        self._lookup: Lookup = _nothing_known
        self._deadline: float | None = None
        self._walk = Walk(state, self._note, self._close, self._take_task)

    @classmethod
    def create(
        cls, run_id: str, scenario: Scenario, parameters: Mapping[str, Value], journal: Journal, *, by: str, now: float
    ) -> Run:
        """A new run; `poll` begins it.

        Raises:
            ScenarioError: a parameter that is missing, unknown, of another kind or out of its range.
        """
        fact = RunCreated(now, run_id, scenario.text, checked_parameters(scenario, parameters), by)
        journal(fact)
        return cls.restore(scenario, [fact], journal)

    @classmethod
    def restore(cls, scenario: Scenario, facts: list[Fact], journal: Journal) -> Run:
        """A run as its journal has it; `again` says what is to be asked for once more."""
        state = RunState()
        for fact in facts:
            state.apply(fact)
        return cls(scenario, state, journal)

    # What the owner tells.

    def poll(self, lookup: Lookup, now: float) -> list[Effect]:
        """Go on as far as possible: time has passed, or values have changed.

        Args:
            lookup: values of robots, for conditions. The run adds parameters and results.
            now: wall clock in seconds, since a run outlives a process.
        """
        self._lookup = lookup
        return self._after(now, lambda moment: None)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next even if nothing changes, or None."""
        return self._deadline

    def again(self, now: float) -> list[Effect]:
        """After a restart: everything that was asked for and has no answer yet. Call it once, before anything else."""
        moment = Moment(now, self.look_up)
        if self.state.outcome is not None:
            return []
        for step, task_run in self.state.tasks.items():
            if task_run.phase in _ACTIVE or self.state.closing is None:
                self._ask(step, moment)
            if task_run.phase in _ACTIVE and self.state.closing is not None:
                moment.effects.append(CancelTask(task_run.execution_id, task_run.robot))
        return moment.effects

    def granted(self, step: str, robot: str, now: float, skill: SkillModel | None = None) -> list[Effect]:
        """A robot is there for a task that waits. What is not wanted any more is given back.

        Its declaration of the skill says in which units it is asked, and brings its defaults.
        """

        def take(moment: Moment) -> None:
            task_run = self.state.tasks.get(step)
            wanted = task_run is not None and task_run.phase is TaskPhase.WANTED
            if task_run is None or not wanted or self.state.paused or self.state.closing is not None:
                moment.effects.append(ReleaseRobot(step))
            elif robot in self._faulted:
                self._replace(step, robot, self._faulted[robot], moment)
            else:
                self._assign(step, task_run, robot, skill, moment)

        return self._after(now, take)

    def nobody(self, step: str, reason: str, now: float) -> list[Effect]:
        """No robot can do a task that waits."""

        def take(moment: Moment) -> None:
            if self.state.phase(step) is TaskPhase.WANTED:
                self._replace(step, "", reason, moment)

        return self._after(now, take)

    def accepted(self, execution_id: str, now: float) -> list[Effect]:
        """A robot has taken a task."""

        def take(moment: Moment) -> None:
            step, task_run = self._active(execution_id)
            if task_run is not None and task_run.phase is TaskPhase.ASSIGNED:
                self._note(TaskAccepted(now, step, task_run.attempt), moment)

        return self._after(now, take)

    def ended(
        self,
        execution_id: str,
        outcome: TaskOutcome,
        now: float,
        *,
        message: str = "",
        results: Mapping[str, Value] | None = None,
    ) -> list[Effect]:
        """A robot's execution has ended; an open question about it is answered. Too late, or twice: it is ignored."""

        def take(moment: Moment) -> None:
            step, task_run = self._active(execution_id, _ACTIVE if outcome is TaskOutcome.UNKNOWN else _ANSWERABLE)
            if task_run is None:
                return
            said = message
            if task_run.phase is TaskPhase.ASKED:
                said = f"{task_run.robot} has told after all: {message or outcome.value}; nobody need answer"
            self._over(step, task_run, outcome, said, results or {}, moment)

        return self._after(now, take)

    def robot_faulted(self, robot: str, reason: str, now: float) -> list[Effect]:
        """A robot cannot work any more."""

        def take(moment: Moment) -> None:
            self._faulted[robot] = reason
            for step, task_run in list(self.state.tasks.items()):
                if task_run.robot == robot and task_run.phase in _ACTIVE:
                    moment.effects.append(CancelTask(task_run.execution_id, robot))
                    self._over(step, task_run, TaskOutcome.FAULT, reason, {}, moment)
                elif task_run.phase is TaskPhase.WANTED and self._robot_for(self.task(step), task_run) == robot:
                    self._replace(step, robot, reason, moment)

        return self._after(now, take)

    def robot_returned(self, robot: str, now: float) -> list[Effect]:
        """A robot works again, and takes its later tasks back, also those that still wait for who stands in."""

        def take(moment: Moment) -> None:
            self._faulted.pop(robot, None)
            if robot not in self.state.stand_ins:
                return
            waiting = [
                (step, self.task(step), self.state.tasks[step]) for step in self.state.in_phase(TaskPhase.WANTED)
            ]
            before = [self._robot_for(task, task_run) for _, task, task_run in waiting]
            self._note(RobotReturned(now, robot), moment)
            for (step, task, task_run), stand_in in zip(waiting, before, strict=True):
                if self._robot_for(task, task_run) != stand_in:
                    moment.effects.append(ReleaseRobot(step))
                    self._ask(step, moment)

        return self._after(now, take)

    def replaced(self, step: str, robot: str, by: str, now: float) -> list[Effect]:
        """A decision was made: this robot takes the task over."""

        def take(moment: Moment) -> None:
            if self.state.phase(step) is TaskPhase.REPLACING:
                self._note(Replaced(now, step, self.state.tasks[step].robot, robot, by), moment)
                self._ask(step, moment)

        return self._after(now, take)

    def not_replaced(self, step: str, reason: str, now: float) -> list[Effect]:
        """Nobody takes the task over."""

        def take(moment: Moment) -> None:
            if self.state.phase(step) is TaskPhase.REPLACING:
                why = f"task {self.task(step).name}: {self.state.tasks[step].reason}; {reason}"
                self._note(StepEnded(now, step, StepState.FAILED, why), moment)

        return self._after(now, take)

    def answered(self, step: str, answer: str, by: str, now: float) -> list[Effect]:
        """An operator says what became of a task: one of ANSWERS.

        Raises:
            ScenarioError: nobody is asked about this step, or another answer.
        """
        if self.state.phase(step) is not TaskPhase.ASKED:
            raise ScenarioError(f"nobody is asked about step {step!r}")
        if answer not in ANSWERS:
            raise ScenarioError(f"{answer!r} is no answer; known answers: {', '.join(ANSWERS)}")

        def take(moment: Moment) -> None:
            self._note(TaskAnswered(now, step, ANSWERS[answer], by), moment)
            self._ask(step, moment)

        return self._after(now, take)

    def event(self, name: str, now: float) -> list[Effect]:
        """An event has happened. Steps that wait for it go on; it is not kept for later ones."""

        def take(moment: Moment) -> None:
            for step, wanted in list(self.state.waiting_for_events.items()):
                if wanted == name:
                    self._note(EventSeen(now, step, name), moment)

        return self._after(now, take)

    def pause(self, by: str, now: float) -> list[Effect]:
        """Start no further task."""

        def take(moment: Moment) -> None:
            if not self.state.paused:
                self._note(RunPaused(now, by), moment)
                moment.effects += [ReleaseRobot(step) for step in self.state.in_phase(TaskPhase.WANTED)]

        return self._after(now, take)

    def resume(self, by: str, now: float) -> list[Effect]:
        """Go on after `pause`."""

        def take(moment: Moment) -> None:
            if self.state.paused:
                self._note(RunResumed(now, by), moment)
                for step in self.state.in_phase(TaskPhase.WANTED):
                    self._ask(step, moment)

        return self._after(now, take)

    def abort(self, reason: str, by: str, now: float) -> list[Effect]:
        """End the run; what robots are at is cancelled."""

        def take(moment: Moment) -> None:
            if self.state.closing is None:
                self._close(RunClosing(now, RunOutcome.ABORTED, reason, by), moment)

        return self._after(now, take)

    def broken(self, reason: str, now: float) -> list[Effect]:
        """End the run at once, which cannot go on; what robots are at is cancelled."""
        moment = Moment(now, self.look_up)
        if self.state.outcome is None:
            for step in self.state.in_phase(*_ACTIVE):
                task_run = self.state.tasks[step]
                moment.effects.append(CancelTask(task_run.execution_id, task_run.robot))
            self._note(RunEnded(now, RunOutcome.FAILED, reason), moment)
        return moment.effects

    # Going on.

    def _after(self, now: float, take: Callable[[Moment], None]) -> list[Effect]:
        """Take something in and go on from there."""
        moment = Moment(now, self.look_up)
        if self.state.outcome is None:
            take(moment)
            self._advance(moment)
        self._deadline = min(moment.deadlines, default=None)
        return moment.effects

    def _advance(self, moment: Moment) -> None:
        self._end_overdue_tasks(moment)
        before = -1
        while before != len(moment.effects) and self.state.closing is None:
            before = len(moment.effects)  # once more where a task that ended lets another branch go on (`after`)
            moment.deadlines.clear()
            ended = self._walk.go(self._scenario.body, moment)
            if ended is not None:
                outcome = RunOutcome.FAILED if ended is StepState.FAILED else RunOutcome.DONE
                self._note(RunEnded(moment.now, outcome, self.state.first_failure), moment)
                return
        if self.state.closing is not None:
            self._finish(self.state.closing, moment)

    def _close(self, fact: RunClosing, moment: Moment) -> None:
        self._note(fact, moment)
        for step, task_run in self.state.tasks.items():
            if task_run.phase in _ACTIVE:
                moment.effects.append(CancelTask(task_run.execution_id, task_run.robot))
            elif task_run.phase is not TaskPhase.OVER:
                moment.effects.append(ReleaseRobot(step))

    def _finish(self, closing: RunClosing, moment: Moment) -> None:
        """End a run that is closing when its tasks are over, or do not end in time."""
        left = [(step, task_run) for step, task_run in self.state.tasks.items() if task_run.phase in _ACTIVE]
        give_up_at = closing.at + CLOSING_GRACE_S
        if left and moment.now < give_up_at:
            moment.deadlines.append(give_up_at)
            return
        reason = closing.reason
        if left:
            robots = ", ".join(sorted({task_run.robot for _, task_run in left}))
            reason = f"{reason}; {robots} did not say that it has stopped"
            moment.effects += [ReleaseRobot(step) for step, _ in left]
        self._note(RunEnded(moment.now, closing.outcome, reason), moment)

    # Tasks.

    def _take_task(self, task: Task, step: str, moment: Moment) -> StepState | None:
        task_run = self.state.tasks.get(step)
        if task_run is None and (lost := self._order.lost(step, self.state)) is not None:
            why = f"task {task.name} comes after {lost}, which was not done"
            self._note(StepEnded(moment.now, step, StepState.FAILED, why), moment)
        elif task_run is None and not self.state.paused and self._order.is_turn(step, self.state):
            task_run = self.state.tasks[step] = TaskRun(task.name)
            robot = self._robot_for(task, task_run)
            if robot is not None and robot in self._faulted:
                self._replace(step, robot, self._faulted[robot], moment)
            else:
                self._ask(step, moment)
        elif task_run is not None and task_run.phase is TaskPhase.ACCEPTED and task.timeout_s is not None:
            moment.deadlines.append(task_run.assigned_at + task.timeout_s)
        return self.state.ended.get(step)

    def _robot_for(self, task: Task, task_run: TaskRun | None) -> str | None:
        """Who is to do a task: the robot that has been given to it or that it names, or who stands in for that one."""
        given = task_run.robot if task_run is not None else ""
        robot = self.state.stand_in_for(given if given and task.robot is None else task.robot or "")
        if task_run is not None and robot in task_run.refused_by:
            robot = self.state.stand_in_for(given)
        return robot or None

    def _assign(self, step: str, task_run: TaskRun, robot: str, skill: SkillModel | None, moment: Moment) -> None:
        task = self.task(step)
        try:
            arguments = arguments_for(task, skill, moment.lookup)
        except ValueUnknown as error:
            moment.effects.append(ReleaseRobot(step))
            self._note(StepEnded(moment.now, step, StepState.FAILED, f"task {task.name}: {error}"), moment)
            return
        attempt = task_run.attempt + 1
        execution_id = uuid.uuid5(_NAMESPACE, f"{self.state.run_id}/{step}/{attempt}").hex
        self._note(
            TaskAssigned(moment.now, step, task.name, attempt, robot, execution_id, task.skill, arguments), moment
        )
        self._ask(step, moment)

    def _over(
        self,
        step: str,
        task_run: TaskRun,
        outcome: TaskOutcome,
        message: str,
        results: Mapping[str, Value],
        moment: Moment,
    ) -> None:
        then = task_run.then(self.task(step), outcome, moment.now, is_closing=self.state.closing is not None)
        message = message or ("" if then is Then.DONE else f"{task_run.skill} on {task_run.robot}: {outcome.value}")
        self._note(TaskOver(moment.now, step, task_run.attempt, outcome, then, message, results), moment)
        moment.effects.append(ReleaseRobot(step))
        self._ask(step, moment)

    def _ask(self, step: str, moment: Moment) -> None:
        """Ask for what a task waits for, also once more."""
        task, task_run = self.task(step), self.state.tasks[step]
        asked = asked_for(step, task, task_run, self._robot_for(task, task_run))
        if asked is not None and not (self.state.paused and task_run.phase is TaskPhase.WANTED):
            moment.effects.append(asked)

    def _replace(self, step: str, robot: str, reason: str, moment: Moment) -> None:
        """Look for another robot for a task that waits."""
        moment.effects.append(ReleaseRobot(step))
        task = self.task(step)
        self._note(ReplacementWanted(moment.now, step, robot, reason, task.name, task.skill), moment)
        self._ask(step, moment)

    def _end_overdue_tasks(self, moment: Moment) -> None:
        for step, task_run in list(self.state.tasks.items()):
            timeout_s = self.task(step).timeout_s
            overdue = timeout_s is not None and moment.now >= task_run.assigned_at + timeout_s
            if overdue and task_run.phase is TaskPhase.ACCEPTED:
                moment.effects.append(CancelTask(task_run.execution_id, task_run.robot))
                self._over(step, task_run, TaskOutcome.TIMED_OUT, f"not done in {timeout_s:g} s", {}, moment)

    def _active(self, execution_id: str, phases: tuple[TaskPhase, ...] = _ACTIVE) -> tuple[str, TaskRun | None]:
        step = self.state.executions.get(execution_id, "")
        task_run = self.state.tasks.get(step)
        if task_run is None or task_run.execution_id != execution_id or task_run.phase not in phases:
            return step, None
        return step, task_run

    def task(self, step: str) -> Task:
        """The task of a step's key, without the numbers of its repetitions."""
        return self._tasks[step.partition("@")[0]]

    def ahead(self) -> Iterator[tuple[str | None, Task]]:
        """The tasks that are not over, with their robots; None where any will do."""
        for step, task in ahead(self._scenario.body, self.state):
            task_run = self.state.tasks.get(step)
            if task_run is None or task_run.phase is TaskPhase.WANTED:
                yield self._robot_for(task, task_run), task
            else:
                yield task_run.robot or None, task

    # Values and facts.

    def look_up(self, name: str) -> Value:
        """A parameter, a task's result or a robot's value now; raises ValueUnknown."""
        state = self.state
        if name in state.parameters:
            return state.parameters[name]
        task, _, result = name.partition(".")
        results = state.results.get(task)
        if results is not None and result in results:
            return results[result]
        return self._lookup(name)

    def _note(self, fact: Fact, moment: Moment) -> None:
        self._journal(fact)
        self.state.apply(fact)
        moment.effects.append(Happened(fact))


def _nothing_known(name: str) -> Value:
    raise ValueUnknown(f"{name} is not known yet")
