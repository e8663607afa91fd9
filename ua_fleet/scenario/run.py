"""One run of a scenario: a pure engine. Inputs are facts of the world with their time; outputs are effects.

What a run decides is first journaled as a fact, then applied, then its effects are returned. So a process that is
killed at any moment builds the same state from the journal and asks for the same effects again, which do no harm twice:
a task's execution id follows from the run, the step and the attempt.

    task:  waits for `after`, then for its robot, which may be silent --granted--> assigned --accepted--> accepted
           assigned, accepted --ended--> over, once more, a replacement, ... as `consequences` says
                              --fault of a robot that stands--> a replacement is wanted
                              --fault, time-out--> halting --ended--> a replacement, once more
                              --silent for too long--> unknown: by `on_unknown` asked, lost, failed, or a replacement
           halting            --not ended in time--> unknown
           replacement wanted --ended, as done: before anybody was chosen--> done
                              --replaced--> waits for that robot
                              --not replaced--> failed, and with it the run
           asked              --answered--> done, once more, failed, or a replacement
                              --replaced, not replaced--> as above: somebody consents, or time decides
           asked, lost        --ended: the robot can tell after all--> as above
                              --accepted: it is still at it--> accepted, unless somebody is asked since it did not halt

What is known of robots (`RobotsView`) is asked for at each step and never kept: whatever order it became known in, a
robot that must not be asked for a task is not.

A paused run starts no task; what robots are at goes on. A run that is aborted cancels it, and ends when all is over.
"""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.scenario.asking import asked_for, cancel, follow
from ua_fleet.scenario.consequences import after_end
from ua_fleet.scenario.effects import DecisionNeeded, Effect, Happened, ReleaseRobot
from ua_fleet.scenario.expression import Lookup, Value, ValueUnknown
from ua_fleet.scenario.facts import (
    EventSeen,
    Fact,
    OutsideTold,
    Replaced,
    ReplacementWanted,
    RobotReturned,
    RunClosing,
    RunCreated,
    RunEnded,
    RunOutcome,
    RunPaused,
    RunResumed,
    StandInTold,
    StepEnded,
    StepState,
    TaskAccepted,
    TaskAnswered,
    TaskAssigned,
    TaskFound,
    TaskOutcome,
    TaskOver,
    Then,
)
from ua_fleet.scenario.model import Scenario, Task
from ua_fleet.scenario.order import TaskOrder, ahead
from ua_fleet.scenario.parameters import arguments_for, checked_parameters
from ua_fleet.scenario.state import RunState, TaskPhase, TaskRun
from ua_fleet.scenario.tending import Tending
from ua_fleet.scenario.walk import StepWalk, WalkState
from ua_fleet.scenario.world import AllWell, RobotsView, Trouble

__all__ = ["ANSWERS", "HELD_PHASES", "Journal", "Run"]

Journal = Callable[[Fact], None]
"""Writes a fact down; when it returns the fact is there after a crash."""

ANSWERS: Final = {"done": Then.DONE, "retry": Then.RETRY, "fail": Then.FAILED, "replace": Then.REPLACE}
"""What an operator may say of a task of which nobody can tell whether it was done."""
CLOSING_GRACE_S: Final = 10.0
"""A run that is to end waits so long for what robots are at."""

_ALL_WELL: Final = AllWell()
_NAMESPACE: Final = uuid.UUID("6f2c4f0e-4f6c-5d0e-9a57-0b8c5d3f7a11")
_ASKED_FOR: Final = (TaskPhase.ASSIGNED, TaskPhase.ACCEPTED)
_ACTIVE: Final = (*_ASKED_FOR, TaskPhase.HALTING)
_NEVER_BEGUN: Final = (TaskOutcome.REFUSED, TaskOutcome.BUSY, TaskOutcome.UNREACHED)
"""What never reached its robot did not take it too long."""
_WAS_HALTED: Final = "it was halted"
_UNCERTAIN: Final = (TaskPhase.ASKED, TaskPhase.LOST)
_DECIDABLE: Final = (TaskPhase.REPLACING, TaskPhase.ASKED)
_NOT_BEGUN: Final = (TaskPhase.REPLACING, TaskPhase.WANTED)
"""Nobody is at it; one that was may say that it is done."""
HELD_PHASES: Final = (*_ACTIVE, *_UNCERTAIN)
"""While a task stands there nobody else gets its robot."""


class Run:
    """A run. Every method that takes something in returns the effects to carry out, in order."""

    def __init__(self, scenario: Scenario, state: RunState, journal: Journal, world: RobotsView) -> None:
        """Use `create` for a new run and `restore` for one of the journal."""
        self._scenario, self._journal, self.state, self._world = scenario, journal, state, world
        self._tasks = {task.key: task for task in scenario.tasks()}
        self._order = TaskOrder(self._tasks.values(), scenario.outside)
        self._lookup: Lookup = _nothing_known
        self._deadline: float | None = None
        self._counted: tuple[int, Counter[str | None]] | None = None
        self._walk = StepWalk(state, self.note, self._close, self._take_task)
        self._tending = Tending(world, self)

    @classmethod
    def create(
        cls,
        run_id: str,
        scenario: Scenario,
        parameters: Mapping[str, Value],
        journal: Journal,
        *,
        by: str,
        now: float,
        world: RobotsView = _ALL_WELL,
    ) -> Run:
        """A new run; `poll` begins it.

        Raises:
            ScenarioError: a parameter that is missing, unknown, of another kind or out of its range.
        """
        fact = RunCreated(now, run_id, scenario.text, checked_parameters(scenario, parameters), by)
        journal(fact)
        return cls.restore(scenario, [fact], journal, world)

    @classmethod
    def restore(cls, scenario: Scenario, facts: list[Fact], journal: Journal, world: RobotsView = _ALL_WELL) -> Run:
        """A run as its journal has it; `again` says what is to be asked for once more."""
        state = RunState()
        for fact in facts:
            state.apply(fact)
        return cls(scenario, state, journal, world)

    # What the owner tells.

    def poll(self, lookup: Lookup, now: float) -> list[Effect]:
        """Go on as far as possible: time has passed, values have changed, or more is known of robots.

        Args:
            lookup: values of robots, for conditions. The run adds parameters and results.
            now: wall clock in seconds, since a run outlives a process.
        """
        self._lookup = lookup
        return self._after(now, lambda moment: None)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next even if nothing changes, or None."""
        return self._deadline

    def again(self, lookup: Lookup, now: float) -> list[Effect]:
        """After a restart: everything that was asked for and has no answer yet. Call it once, before anything else."""
        self._lookup = lookup
        moment = WalkState(now, self.look_up)
        if self.state.outcome is not None:
            return []
        for step, task_run in self.state.tasks.items():
            if task_run.phase in _ASKED_FOR and self._trouble(task_run.robot, step) is not None:
                moment.effects.append(follow(step, task_run))  # what was not begun yet must not be now
            elif task_run.phase in _ACTIVE or self.state.closing is None:
                if task_run.phase in _NOT_BEGUN and task_run.execution_id:
                    moment.effects.append(follow(step, task_run))  # what it said meanwhile was not heard
                self.ask(step, moment, is_again=True)
            is_to_stop = self.state.closing is not None or task_run.phase is TaskPhase.HALTING
            if task_run.phase in _ACTIVE and is_to_stop:
                moment.effects.append(cancel(task_run))
        return moment.effects

    def granted(self, step: str, robot: str, now: float, skill: SkillModel | None = None) -> list[Effect]:
        """A robot is there for a task that waits. What is not wanted any more is given back.

        Its declaration of the skill says in which units it is asked, and brings its defaults.
        """

        def take(moment: WalkState) -> None:
            task_run = self.state.tasks.get(step)
            self._tending.queued(step, "")
            wanted = task_run is not None and task_run.phase is TaskPhase.WANTED
            if task_run is None or not wanted or self.state.paused or self.state.closing is not None:
                moment.effects.append(ReleaseRobot(step))
            elif (trouble := self._trouble(robot, step)) is not None:
                self.replace(step, robot, trouble.told or trouble.reason, moment)
            elif self._world.silent_since(robot) is None and self._world.occupied(robot) is None:
                if self.missing(self.task(step), moment) is not None:
                    self._tending.lacks(step)
                    return
                self._assign(step, task_run, robot, skill, moment)
            elif self.robot_for(self.task(step), task_run) is None:  # it is for anybody who is heard, and free
                moment.effects.append(ReleaseRobot(step))
                self.ask(step, moment)
            else:
                self._tending.held(step)

        return self._after(now, take)

    def nobody(self, step: str, reason: str, now: float) -> list[Effect]:
        """No robot can do a task that waits."""

        def take(moment: WalkState) -> None:
            if self.state.phase(step) is TaskPhase.WANTED:
                self.replace(step, "", reason, moment)

        return self._after(now, take)

    def waits(self, step: str, reason: str, now: float, robot: str = "") -> list[Effect]:
        """A task waits: for a robot that another run has, or, without `robot`, for any that can do it. Empty: it does
        not wait for that any more.
        """

        def take(moment: WalkState) -> None:
            if self.state.phase(step) is not TaskPhase.WANTED:
                return
            if robot:
                self._tending.queued(step, reason)  # it is told with what else keeps the task from its robot
            else:
                self._tending.tell(step, self.task(step), "", reason, moment)

        return self._after(now, take)

    def accepted(self, execution_id: str, now: float) -> list[Effect]:
        """A robot has taken a task, or is found to be still at it."""

        def take(moment: WalkState) -> None:
            step, task_run = self._known(execution_id)
            if task_run is None:
                return
            if task_run.phase is TaskPhase.ASSIGNED:
                self.note(TaskAccepted(now, step, task_run.attempt), moment)
            elif task_run.phase in _UNCERTAIN and task_run.halting is not None:
                return  # it was told to stop, and did not: that it goes on answers nothing
            elif task_run.phase in _UNCERTAIN:
                self.note(TaskFound(now, step, task_run.attempt), moment)

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

        def take(moment: WalkState) -> None:
            step, task_run = self._known(execution_id, is_done=outcome is TaskOutcome.DONE)
            if task_run is None or (outcome is TaskOutcome.UNKNOWN and self._is_unknown(task_run)):
                return
            how, said, halting = outcome, message, task_run.halting
            if task_run.execution_id != execution_id:  # another robot was asked for it a moment ago
                moment.effects.append(cancel(task_run))
                said = f"it was done before {task_run.robot} began: {message or outcome.value}"
            elif task_run.phase not in _ACTIVE:
                said = f"{task_run.executed_by} reported late: {message or outcome.value}; the question is closed"
            if halting is not None and outcome not in (TaskOutcome.DONE, TaskOutcome.UNKNOWN):
                is_begun = halting.outcome is not TaskOutcome.TIMED_OUT or outcome not in _NEVER_BEGUN
                how = halting.outcome if is_begun and outcome is not TaskOutcome.STOPPED else outcome
                if task_run.phase is TaskPhase.HALTING:
                    told = message or outcome.value
                    said = f"{halting.reason}; {told if told.startswith(_WAS_HALTED) else f'{_WAS_HALTED}: {told}'}"
            elif outcome is TaskOutcome.HALTED:
                who = f"a client halted {task_run.skill} on {task_run.executed_by}"
                said = f"task {task_run.name}: {who}, so that nobody begins it: {message or outcome.value}"
            self.over(step, task_run, how, said, results or {}, moment, is_told=True)

        return self._after(now, take)

    def replaced(self, step: str, robot: str, by: str, now: float) -> list[Effect]:
        """A decision was made: this robot takes the task over."""

        def take(moment: WalkState) -> None:
            task_run = self.state.tasks.get(step)
            if task_run is None or task_run.phase not in _DECIDABLE:
                return
            failed = task_run.robot
            needs = self._world.needs(failed, self.task(step))
            lasts = not failed or self._tending.is_away(failed, needs)
            taken: tuple[str, ...] = ()
            if not self._tending.is_away(failed):
                taken = tuple(name for name in needs if failed == robot or self._world.trouble(failed, (name,)))
            self._let_go(step, task_run, moment)
            self.note(Replaced(now, step, failed, robot, by, lasts, taken), moment)
            self.ask(step, moment)

        return self._after(now, take)

    def not_replaced(self, step: str, reason: str, now: float) -> list[Effect]:
        """Nobody takes the task over."""

        def take(moment: WalkState) -> None:
            task_run = self.state.tasks.get(step)
            if task_run is None or task_run.phase not in _DECIDABLE:
                return
            self._let_go(step, task_run, moment)
            said = "; ".join(f"{robot}: {text}" for robot, text in task_run.said.items() if text != task_run.reason)
            last = next((robot for robot, text in task_run.said.items() if text == task_run.reason), "")
            first = task_run.reason if last in task_run.reason else f"{last}: {task_run.reason}"
            begun = "" if task_run.attempt else " was not begun"
            why = f"task {self.task(step).name}{begun}: {first}; {reason}{f' ({said})' if said else ''}"
            self.note(StepEnded(now, step, StepState.FAILED, why), moment)

        return self._after(now, take)

    def answered(self, step: str, answer: str, by: str, now: float) -> list[Effect]:
        """An operator says what became of a task: one of ANSWERS.

        Raises:
            ScenarioError: nobody is asked about this step, or another answer.
        """
        if self.state.phase(step) is not TaskPhase.ASKED:
            raise ScenarioError(f"step {step!r} asks no question")
        if answer not in ANSWERS:
            raise ScenarioError(f"{answer!r} is no answer; known answers: {', '.join(ANSWERS)}")

        def take(moment: WalkState) -> None:
            task_run, then = self.state.tasks[step], ANSWERS[answer]
            if then is Then.RETRY and self._tending.silent_since(task_run) is not None:
                then = Then.AWAIT
            else:
                self._let_go(step, task_run, moment)
            self.note(TaskAnswered(now, step, then, by), moment)
            self.ask(step, moment)

        return self._after(now, take)

    def event(self, name: str, now: float) -> list[Effect]:
        """An event has happened. Steps that wait for it go on; it is not kept for later ones."""

        def take(moment: WalkState) -> None:
            for step, wanted in list(self.state.waiting_for_events.items()):
                if wanted == name:
                    self.note(EventSeen(now, step, name), moment)

        return self._after(now, take)

    def told(self, task: str, now: float, *, is_done: bool, results: Mapping[str, Value]) -> list[Effect]:
        """What became of a task that another part of a carried run does; said again, nothing changes."""

        def take(moment: WalkState) -> None:
            known = self.state.outside.get(task)
            if known is None or (is_done and (not known or self.state.results.get(task) != results)):
                self.note(OutsideTold(now, task, is_done, results), moment)

        return self._after(now, take)

    def stand_in_told(self, failed: str, robot: str, capacity: str, now: float) -> list[Effect]:
        """Who stands in for a robot, as another part of a carried run has chosen; said again, nothing changes."""

        def take(moment: WalkState) -> None:
            if self.state.stand_ins.get(failed, {}).get(capacity) != robot:
                with self._asking_again(moment):
                    self.note(StandInTold(now, failed, robot, capacity), moment)

        return self._after(now, take)

    def pause(self, by: str, now: float) -> list[Effect]:
        """Start no further task."""

        def take(moment: WalkState) -> None:
            if not self.state.paused:
                self.note(RunPaused(now, by), moment)
                moment.effects += [ReleaseRobot(step) for step in self.state.in_phase(TaskPhase.WANTED)]

        return self._after(now, take)

    def resume(self, by: str, now: float) -> list[Effect]:
        """Go on after `pause`."""

        def take(moment: WalkState) -> None:
            if self.state.paused:
                self.note(RunResumed(now, by), moment)
                for step in self.state.in_phase(TaskPhase.WANTED):
                    self.ask(step, moment)

        return self._after(now, take)

    def abort(self, reason: str, by: str, now: float) -> list[Effect]:
        """End the run; what robots are at is cancelled."""

        def take(moment: WalkState) -> None:
            if self.state.closing is None:
                self._close(RunClosing(now, RunOutcome.ABORTED, reason, by), moment)

        return self._after(now, take)

    def broken(self, reason: str, now: float) -> list[Effect]:
        """End the run at once, which cannot go on; what robots are at is cancelled."""
        moment = WalkState(now, self.look_up)
        if self.state.outcome is None:
            for step in self.state.in_phase(*HELD_PHASES):
                moment.effects.append(cancel(self.state.tasks[step]))
            self.note(RunEnded(now, RunOutcome.FAILED, reason), moment)
        return moment.effects

    # Going on.

    def _after(self, now: float, take: Callable[[WalkState], None]) -> list[Effect]:
        """Take something in and go on from there."""
        moment = WalkState(now, self.look_up)
        if self.state.outcome is None:
            take(moment)
            if self.state.closing is None:
                self._take_back(moment)
            self._advance(moment)
        self._deadline = min(moment.deadlines, default=None)
        return moment.effects

    def _take_back(self, moment: WalkState) -> None:
        """Robots that are back take their later tasks back, also those that still wait for who stands in."""
        failed = [(robot, capacity) for robot, named in self.state.stand_ins.items() for capacity in named]
        for robot, capacity in failed:
            if self._tending.is_away(robot, (capacity,) if capacity else ()):
                continue
            with self._asking_again(moment):
                self.note(RobotReturned(moment.now, robot, capacity), moment)

    @contextmanager
    def _asking_again(self, moment: WalkState) -> Generator[None]:
        """Have tasks that wait for a robot ask for another one, where it is another one after what happens within."""
        waiting = [(step, self.task(step), self.state.tasks[step]) for step in self.state.in_phase(TaskPhase.WANTED)]
        before = [self.robot_for(task, task_run) for _, task, task_run in waiting]
        yield
        for (step, task, task_run), robot in zip(waiting, before, strict=True):
            if self.robot_for(task, task_run) != robot:
                moment.effects.append(ReleaseRobot(step))
                self.ask(step, moment)

    def _advance(self, moment: WalkState) -> None:
        before = -1
        while before != len(moment.effects) and self.state.closing is None:
            before = len(moment.effects)  # once more where a task that ended lets another branch go on (`after`)
            moment.deadlines.clear()
            ended = self._walk.go(self._scenario.body, moment, self._scenario.scope)
            if ended is not None:
                outcome = RunOutcome.FAILED if ended is StepState.FAILED else RunOutcome.DONE
                self.note(RunEnded(moment.now, outcome, self.state.first_failure), moment)
                return
        if self.state.closing is not None:
            self._finish(self.state.closing, moment)

    def _close(self, fact: RunClosing, moment: WalkState) -> None:
        self.note(fact, moment)
        for step, task_run in self.state.tasks.items():
            if task_run.phase in HELD_PHASES:
                moment.effects.append(cancel(task_run))
            if task_run.phase not in (*_ACTIVE, TaskPhase.OVER):
                moment.effects.append(ReleaseRobot(step))

    def _finish(self, closing: RunClosing, moment: WalkState) -> None:
        """End a run that is closing when its tasks are over, or do not end in time."""
        left = [(step, task_run) for step, task_run in self.state.tasks.items() if task_run.phase in _ACTIVE]
        give_up_at = closing.at + CLOSING_GRACE_S
        if left and moment.now < give_up_at:
            moment.deadlines.append(give_up_at)
            return
        reason = closing.reason
        if left:
            robots = ", ".join(sorted({task_run.robot for _, task_run in left}))
            reason = f"{reason}; {robots} did not confirm that it has stopped"
            moment.effects += [ReleaseRobot(step) for step, _ in left]
        self.note(RunEnded(moment.now, closing.outcome, reason), moment)

    # Tasks.

    def _take_task(self, task: Task, step: str, moment: WalkState) -> StepState | None:
        task_run = self.state.tasks.get(step)
        if task_run is None and (lost := self._order.lost(step, self.state)) is not None:
            why = f"task {task.name} comes after {lost}, which was not done"
            self.note(StepEnded(moment.now, step, StepState.FAILED, why), moment)
        elif task_run is None and not self.state.paused and self._order.is_turn(step, self.state):
            task_run = self.state.tasks[step] = TaskRun(task.name)
            if not self._tending.is_tended(step, task, task_run, moment):
                self.ask(step, moment)
        elif task_run is not None:
            self._tending.is_tended(step, task, task_run, moment)
        return self.state.ended.get(step)

    def robot_for(self, task: Task, task_run: TaskRun | None) -> str | None:
        """Who is to do a task: the robot that has been given to it or that it names, or who stands in for that one."""
        given = task_run.robot if task_run is not None else ""
        is_given = given and (task.robot is None or (task_run is not None and task_run.is_own))

        def needs(robot: str) -> tuple[str, ...]:
            return self._world.needs(robot, task)

        robot = self.state.stand_in_for(given if is_given else task.robot or "", needs)
        if task_run is not None and robot in task_run.excluded:
            robot = self.state.stand_in_for(given, needs)
        return robot or None

    def _trouble(self, robot: str, step: str) -> Trouble | None:
        return self._world.trouble(robot, self._world.needs(robot, self.task(step)))

    def missing(self, task: Task, moment: WalkState) -> ValueUnknown | None:
        """The first argument that has no value now."""
        try:
            arguments_for(task, None, moment.lookup)
        except ValueUnknown as error:
            return error
        return None

    def fail(self, step: str, reason: str, moment: WalkState) -> None:
        """A task that waits for a robot, or has one that was not asked yet, cannot be done."""
        moment.effects.append(ReleaseRobot(step))
        self.note(StepEnded(moment.now, step, StepState.FAILED, reason), moment)

    def _assign(self, step: str, task_run: TaskRun, robot: str, skill: SkillModel | None, moment: WalkState) -> None:
        task = self.task(step)
        arguments = arguments_for(task, skill, moment.lookup)
        attempt = task_run.attempt + 1
        execution_id = uuid.uuid5(_NAMESPACE, f"{self.state.run_id}/{step}/{attempt}").hex
        self.note(
            TaskAssigned(moment.now, step, task.name, attempt, robot, execution_id, task.skill, arguments), moment
        )
        self.ask(step, moment)

    def over(
        self,
        step: str,
        task_run: TaskRun,
        outcome: TaskOutcome,
        message: str,
        results: Mapping[str, Value],
        moment: WalkState,
        *,
        is_told: bool = False,
    ) -> None:
        """An attempt has ended; `is_told` by the robot's side."""
        then = after_end(
            self.task(step),
            task_run,
            outcome,
            moment.now,
            is_silent=self._tending.silent_since(task_run) is not None,
            silence_s=self._world.silence_s,
            return_s=self._world.return_s,
            is_closing=self.state.closing is not None,
        )
        message = message or ("" if then is Then.DONE else f"{task_run.skill} on {task_run.robot}: {outcome.value}")
        if outcome is TaskOutcome.UNKNOWN and then is Then.FAILED:
            message = (
                f"task {task_run.name}: {message}; it is unknown whether it is done, so no other robot may begin it"
            )
        if outcome is TaskOutcome.UNKNOWN and then in (Then.REPLACE, Then.FAILED):
            moment.effects.append(cancel(task_run))
        self.note(TaskOver(moment.now, step, task_run.attempt, outcome, then, message, results), moment)
        is_open = outcome is TaskOutcome.UNKNOWN or (outcome is TaskOutcome.FAULT and not is_told)
        if then is Then.REPLACE and is_open:
            moment.effects.append(follow(step, task_run))  # its robot may say that it was done
        if then not in (Then.ASK, Then.AWAIT):  # nobody else gets a robot of which it is not known what it is at
            moment.effects.append(ReleaseRobot(step))
        self.ask(step, moment)

    def _let_go(self, step: str, task_run: TaskRun, moment: WalkState) -> None:
        """Nobody waits any more for what a robot is at: it is to stop, or not to begin, when it is heard again."""
        if task_run.phase is TaskPhase.ASKED:
            moment.effects += [cancel(task_run), ReleaseRobot(step)]

    def ask(self, step: str, moment: WalkState, *, is_again: bool = False) -> None:
        """Ask for what a task waits for, also once more: `is_again` after a restart."""
        task, task_run = self.task(step), self.state.tasks[step]
        asked = asked_for(step, task, task_run, self.robot_for(task, task_run))
        if is_again and isinstance(asked, DecisionNeeded) and task_run.execution_id:
            asked = replace(asked, may_be_done=True)
        if asked is not None and not (self.state.paused and task_run.phase is TaskPhase.WANTED):
            moment.effects.append(asked)

    def replace(self, step: str, robot: str, reason: str, moment: WalkState) -> None:
        """Look for another robot for a task that waits."""
        moment.effects.append(ReleaseRobot(step))
        task = self.task(step)
        self.note(ReplacementWanted(moment.now, step, robot, reason, task.name, task.skill), moment)
        self.ask(step, moment)

    def _known(self, execution_id: str, *, is_done: bool = False) -> tuple[str, TaskRun | None]:
        """The task that waits for the end of an execution; what is done need not be done by who is looked for."""
        step = self.state.executions.get(execution_id, "")
        task_run = self.state.tasks.get(step)
        if task_run is None:
            return step, None
        is_now = task_run.execution_id == execution_id
        if is_now and task_run.phase in ((*HELD_PHASES, *_NOT_BEGUN) if is_done else HELD_PHASES):
            return step, task_run
        is_before = is_done and task_run.execution_before == execution_id
        return step, task_run if is_before and task_run.phase is TaskPhase.ASSIGNED else None

    def _is_unknown(self, task_run: TaskRun) -> bool:
        """Whether that nobody can tell is nothing new."""
        is_silent = self._tending.silent_since(task_run) is not None
        return task_run.phase is TaskPhase.ASKED or (task_run.phase is TaskPhase.LOST and is_silent)

    def task(self, step: str) -> Task:
        """The task of a step's key, without the numbers of its repetitions."""
        return self._tasks[step.partition("@")[0]]

    def ahead(self) -> Iterator[tuple[str | None, Task]]:
        """The tasks that are not over, with their robots; None where any will do."""
        for step, task in ahead(self._scenario.body, self.state, self._scenario.scope):
            task_run = self.state.tasks.get(step)
            if task_run is None or task_run.phase is TaskPhase.WANTED:
                yield self.robot_for(task, task_run), task
            else:
                yield task_run.robot or None, task

    def count_ahead(self) -> Mapping[str | None, int]:
        """How many tasks each robot has `ahead`, counted anew only once something has happened."""
        known = len(self.state.tasks)
        if self._counted is None or self._counted[0] != known:
            self._counted = known, Counter(robot for robot, _ in self.ahead())
        return self._counted[1]

    # Values and facts.

    def look_up(self, name: str) -> Value:
        """A parameter, a task's result or a robot's value now; raises ValueUnknown."""
        state = self.state
        task, _, result = name.partition(".")
        results = state.results.get(task)
        if results is not None and result in results:
            return results[result]
        if name in state.parameters:  # of a part, also results of steps before it
            return state.parameters[name]
        return self._lookup(name)

    def note(self, fact: Fact, moment: WalkState) -> None:
        """Journal a fact, then apply it, then tell it."""
        self._journal(fact)
        self.state.apply(fact)
        self._counted = None
        moment.effects.append(Happened(fact))


def _nothing_known(name: str) -> Value:
    raise ValueUnknown(f"{name} is not known yet")
