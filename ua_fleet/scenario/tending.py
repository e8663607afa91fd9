"""What becomes of a task by what is known of its robot now: a fault, silence, too much time.

Nothing here is told: the robots are looked at each time a run goes on, so that no order of news counts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from math import inf
from typing import Final, Protocol

from ua_fleet.scenario.asking import cancel
from ua_fleet.scenario.consequences import BUSY_S, HALT_S, LEAST_SILENCE_S, SETTLE_S, TELL_S, VALUE_S
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.expression import Value, ValueUnknown
from ua_fleet.scenario.facts import Fact, TaskFound, TaskHalting, TaskOutcome
from ua_fleet.scenario.model import Task
from ua_fleet.scenario.state import RunState, TaskPhase, TaskRun
from ua_fleet.scenario.walk import WalkState
from ua_fleet.scenario.world import RobotsView

__all__ = ["Tended", "Tending"]

_UNCERTAIN: Final = (TaskPhase.ASKED, TaskPhase.LOST)
_BEGUN: Final = (TaskPhase.ASSIGNED, TaskPhase.ACCEPTED, TaskPhase.HALTING, *_UNCERTAIN)


class Tended(Protocol):
    """What a run can do for one of its tasks."""

    state: RunState

    def robot_for(self, task: Task, task_run: TaskRun | None) -> str | None:
        """Who is to do a task."""
        ...

    def over(
        self,
        step: str,
        task_run: TaskRun,
        outcome: TaskOutcome,
        message: str,
        results: Mapping[str, Value],
        moment: WalkState,
    ) -> None:
        """An attempt has ended."""
        ...

    def replace(self, step: str, robot: str, reason: str, moment: WalkState) -> None:
        """Look for another robot for a task that waits."""
        ...

    def ask(self, step: str, moment: WalkState) -> None:
        """Ask for what a task waits for, also once more."""
        ...

    def missing(self, task: Task, moment: WalkState) -> ValueUnknown | None:
        """The first argument that has no value now."""
        ...

    def fail(self, step: str, reason: str, moment: WalkState) -> None:
        """A task that was not begun cannot be done."""
        ...

    def note(self, fact: Fact, moment: WalkState) -> None:
        """Journal and apply a fact."""
        ...


class Tending:
    """Holds the tasks of a run against the world."""

    def __init__(self, world: RobotsView, run: Tended) -> None:
        """Look after the tasks of a run."""
        self._world, self._run = world, run
        self._held: set[str] = set()
        """Tasks that have their robot, and wait until it is heard, or free."""
        self._queued: dict[str, str] = {}
        """Why tasks do not have their robots yet: what other runs do with these."""
        self._occupied_since: dict[str, float] = {}
        """Since when the robots that tasks have are not free (`RobotsView.occupied`); begins anew after a restart."""
        self._lacking: dict[str, float | None] = {}
        """Tasks that have their robot and lack the value of an argument, and since when; None: whose value it is, is
        silent. Begins anew after a restart.
        """
        self._told: dict[str, str] = {}
        """Why tasks wait, as it was told last."""
        self._taken_back: set[str] = set()
        """Executions of which nobody knows, and whose robots have a fault."""
        self._heard_since: dict[str, float] = {}
        """Since when the robots of executions are heard again of which nobody knows."""
        self._standing_since: dict[str, float] = {}
        """Since when robots are heard, and known to stand, whose last word on executions is waited for."""

    def held(self, step: str) -> None:
        """A task has its robot, which is silent, or is at something else."""
        self._held.add(step)

    def queued(self, step: str, reason: str) -> None:
        """A task waits for a robot that another run has; without a reason, it does not."""
        if reason:
            self._queued[step] = reason
        else:
            self._queued.pop(step, None)

    def lacks(self, step: str) -> None:
        """A task has its robot, and an argument of it has no value now."""
        self._lacking.setdefault(step, None)

    def is_away(self, robot: str, needs: Collection[str] = ()) -> bool:
        """Whether a robot cannot be asked now for what needs some capacities; without them: for anything at all."""
        return self._world.silent_since(robot) is not None or self._world.trouble(robot, needs) is not None

    def silent_since(self, task_run: TaskRun) -> float | None:
        """Since when neither the robot of an attempt is heard, nor its word that it is at it; None: one of them is."""
        since = self._world.silent_since(task_run.robot)
        if since is None or not task_run.execution_id:
            return since
        until = self._world.followed_until(task_run.robot, task_run.execution_id)
        return None if until == inf else max(since, until)

    def is_tended(self, step: str, task: Task, task_run: TaskRun, moment: WalkState) -> bool:
        """Do what follows from what is known; whether that was something, so that the task need not be asked for."""
        if task_run.phase is TaskPhase.WANTED:
            if self._run.state.paused:
                self._forget(step)
                return False
            return self._is_wanted_tended(step, task, task_run, moment)
        self._forget(step)
        if task_run.phase in _BEGUN:
            self._tend_begun(step, task, task_run, moment)
        return True

    def _is_wanted_tended(self, step: str, task: Task, task_run: TaskRun, moment: WalkState) -> bool:
        robot = self._run.robot_for(task, task_run)
        if robot is None:
            return self._is_value_tended(step, task, "", moment)  # whoever has the robots finds one
        if (trouble := self._world.trouble(robot, self._world.needs(robot, task))) is not None:
            self._give_up(step, robot, trouble.told or trouble.reason, moment)
            return True
        since, occupied = self._world.silent_since(robot), self._world.occupied(robot)
        if since is not None:
            until, gives_up = since + self._world.silence_s, self._silent(robot)
            why = self._explained(robot, f"nothing is heard of {robot}")
        elif occupied is not None and step in self._held:
            until = self._occupied_since.setdefault(step, moment.now) + BUSY_S
            why, gives_up = occupied, f"{occupied}; it was waited for {BUSY_S:g} s"
        elif step in self._lacking:
            return self._is_value_tended(step, task, robot, moment)
        else:
            was_held, queued = step in self._held, self._queued.get(step, "")
            self.tell(step, task, robot, queued, moment)
            if queued:
                return False
            self._forget(step)
            if was_held:
                self._run.ask(step, moment)
            return was_held
        if step in self._lacking:
            self._lacking[step] = None
        if moment.now < until:
            moment.deadlines.append(until)
            self.tell(step, task, robot, why, moment)
            return False
        self._give_up(step, robot, gives_up, moment)
        return True

    def _is_value_tended(self, step: str, task: Task, robot: str, moment: WalkState) -> bool:
        """See to a task that may lack the value of an argument, and would begin now if it were known."""
        if step not in self._lacking:
            return False
        missing = self._run.missing(task, moment)
        if missing is None:
            self.tell(step, task, robot, "", moment)
            self._forget(step)
            self._run.ask(step, moment)
            return True
        silent_since = self._world.silent_since(missing.robot) if missing.robot else None
        if silent_since is not None:
            self._lacking[step], until = None, silent_since + self._world.silence_s
        else:
            since = self._lacking[step]
            since = self._lacking[step] = moment.now if since is None else since
            until = since + VALUE_S
        if moment.now < until:
            moment.deadlines.append(until)
            self.tell(step, task, robot, str(missing), moment)
            return False
        self._forget(step)
        self._run.fail(step, f"task {task.name}: {missing}", moment)
        return True

    def tell(self, step: str, task: Task, robot: str, reason: str, moment: WalkState) -> None:
        """Say why a task waits, where that is new."""
        if self._told.get(step, "") != reason:
            self._told[step] = reason
            moment.effects.append(TaskWaits(step, task.name, task.skill, robot, reason))

    def _give_up(self, step: str, robot: str, reason: str, moment: WalkState) -> None:
        self._forget(step)
        self._run.replace(step, robot, reason, moment)

    def _forget(self, step: str) -> None:
        """A task does not have its robot any more, or has no reason to wait with it."""
        self._held.discard(step)
        self._queued.pop(step, None)
        self._occupied_since.pop(step, None)
        self._lacking.pop(step, None)
        self._told.pop(step, None)

    def _tend_begun(self, step: str, task: Task, task_run: TaskRun, moment: WalkState) -> None:
        robot, phase = task_run.robot, task_run.phase
        trouble = self._world.trouble(robot, self._world.needs(robot, task))
        since = self.silent_since(task_run)
        if trouble is not None and trouble.stands:
            self._tend_standing(step, task_run, since, trouble.reason, moment)
        elif phase is TaskPhase.HALTING:
            self._tend_halting(step, task_run, since, moment)
        elif phase in _UNCERTAIN:
            if trouble is not None and task_run.execution_id not in self._taken_back:
                self._taken_back.add(task_run.execution_id)  # its request may be on its way still
                moment.effects.append(cancel(task_run))
            if phase is TaskPhase.LOST and trouble is None and self._says_it_is_at(task_run):
                self._run.note(TaskFound(moment.now, step, task_run.attempt), moment)
                self._tend_begun(step, task, task_run, moment)
            elif phase is TaskPhase.LOST:
                self._tend_lost(step, task_run, since, moment)
        elif trouble is not None:
            self._halt(step, task_run, TaskOutcome.FAULT, trouble.reason, moment)
        elif since is not None:
            self._tend_silent(step, task, task_run, since, moment)
        elif phase is TaskPhase.ACCEPTED and task.timeout_s is not None:
            due = task_run.assigned_at + task.timeout_s
            if moment.now < due:
                moment.deadlines.append(due)
            else:
                self._halt(step, task_run, TaskOutcome.TIMED_OUT, f"not done in {task.timeout_s:g} s", moment)

    def _says_it_is_at(self, task_run: TaskRun) -> bool:
        """Whether a robot that was lost says that it is at a task still, and was not told to stop."""
        until = self._world.followed_until(task_run.robot, task_run.execution_id)
        return until == inf and task_run.halting is None

    def _tend_standing(self, step: str, task_run: TaskRun, since: float | None, reason: str, moment: WalkState) -> None:
        """Who can say that it has a fault stands: what it was at is over. It may just be saying that it was done."""
        if task_run.phase is not TaskPhase.HALTING:
            self._run.note(TaskHalting(moment.now, step, task_run.attempt, TaskOutcome.FAULT, reason), moment)
            moment.effects.append(cancel(task_run))
        if since is None:
            until = self._standing_since.setdefault(task_run.execution_id, moment.now) + SETTLE_S
        else:
            self._standing_since.pop(task_run.execution_id, None)
            until = max(since + LEAST_SILENCE_S, moment.now if task_run.halting is None else task_run.halting.at)
        if moment.now < until:
            moment.deadlines.append(until)
            return
        self._standing_since.pop(task_run.execution_id, None)
        self._run.over(step, task_run, TaskOutcome.FAULT, reason, {}, moment)

    def _tend_lost(self, step: str, task_run: TaskRun, since: float | None, moment: WalkState) -> None:
        """A robot may be at it that is waited for: not for ever, and once it is heard, not for long."""
        until = (moment.now if task_run.lost_since is None else task_run.lost_since) + self._world.return_s
        if since is None:
            until = min(until, self._heard_since.setdefault(task_run.execution_id, moment.now) + TELL_S)
            said = f"{task_run.reason}; {task_run.robot} does not say what became of it"
        else:
            self._heard_since.pop(task_run.execution_id, None)
            said = f"{task_run.reason}, nor for the {self._world.return_s:g} s for which it was waited for"
        if moment.now < until:
            moment.deadlines.append(until)
            return
        self._heard_since.pop(task_run.execution_id, None)
        self._run.over(step, task_run, TaskOutcome.UNKNOWN, said, {}, moment)

    def _tend_halting(self, step: str, task_run: TaskRun, since: float | None, moment: WalkState) -> None:
        halting = task_run.halting
        assert halting is not None, "the fact that made the phase"
        until = halting.at + HALT_S
        if since is not None:
            until = max(until, since + self._world.silence_s)
        if moment.now < until:
            moment.deadlines.append(until)
            return
        said = f"{halting.reason}; {task_run.robot} did not confirm that it has stopped"
        self._run.over(step, task_run, TaskOutcome.UNKNOWN, said, {}, moment)

    def _tend_silent(self, step: str, task: Task, task_run: TaskRun, since: float, moment: WalkState) -> None:
        until, why = since + self._world.silence_s, self._silent(task_run.robot)
        if task.timeout_s is not None:
            due = max(task_run.assigned_at + task.timeout_s, since + LEAST_SILENCE_S)
            if due < until:
                until, why = (
                    due,
                    self._explained(
                        task_run.robot, f"not done in {task.timeout_s:g} s, and {task_run.robot} is silent"
                    ),
                )
        if moment.now < until:
            moment.deadlines.append(until)
        else:
            self._run.over(step, task_run, TaskOutcome.UNKNOWN, why, {}, moment)

    def _halt(self, step: str, task_run: TaskRun, outcome: TaskOutcome, reason: str, moment: WalkState) -> None:
        """Have the robot stop. Nobody else begins before it says that it has."""
        self._run.note(TaskHalting(moment.now, step, task_run.attempt, outcome, reason), moment)
        moment.effects.append(cancel(task_run))
        moment.deadlines.append(moment.now + HALT_S)

    def _silent(self, robot: str) -> str:
        return self._explained(robot, f"nothing is heard of {robot} for {self._world.silence_s:g} s")

    def _explained(self, robot: str, what: str) -> str:
        why = self._world.why_silent(robot)
        return f"{what}: {why}" if why else what
