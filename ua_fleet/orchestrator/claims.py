"""Which task has which robot, and who waits for one: for a robot by its name, or for whichever can do the task."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from ua_fleet.orchestrator.choosing import Choosing
from ua_fleet.orchestrator.halts import Halts
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.orchestrator.under_way import RunsUnderWay
from ua_fleet.resilience import Ranking
from ua_fleet.scenario import Grant, Reservations, Run
from ua_fleet.scenario.effects import WantRobot
from ua_fleet.scenario.state import TaskPhase

__all__ = ["Claim", "Claims"]

_DOES: Final[dict[TaskPhase | None, str]] = {
    TaskPhase.WANTED: "is to do",
    TaskPhase.HALTING: "is to stop",
    TaskPhase.LOST: "may still be at",
}
Claim = tuple[str, str]
"""A run's id and a step of it."""


@dataclass(slots=True)
class _Anybody:
    """A task that waits for whichever robot can do it."""

    wanted: WantRobot
    looked_at: object = None
    """What the last look was by; while it is the same, only a robot that is free again changes anything."""
    hope_until: float | None = None
    """So long a robot may still be heard that can, or be free, where none is."""
    since: float | None = None
    """Since when there is none."""


class Claims:
    """The claims of all runs."""

    def __init__(
        self,
        known: Knowledge,
        choosing: Choosing,
        runs: RunsUnderWay,
        reservations: Reservations[Claim],
        halts: Halts,
    ) -> None:
        """Begin with none.

        Args:
            known: the robots.
            choosing: ranks them.
            runs: told of the robots that they have.
            reservations: who has which robot; `halts` has some, too.
            halts: what robots have not stopped.
        """
        self._known, self._choosing, self._runs = known, choosing, runs
        self._reservations, self._halts = reservations, halts
        self._anybody: dict[Claim, _Anybody] = {}
        self._told: dict[Claim, str] = {}
        """Who has the robots that tasks wait for, as it was told last."""
        self._granted: dict[Claim, str] = {}
        """Robots of which runs are to be told that they have them."""
        choosing.promised = self._promised

    def want(self, run_id: str, wanted: WantRobot, now: float) -> None:
        """A task waits for its robot, or for any."""
        if wanted.robot is None:
            self._want_anybody(run_id, wanted, now)
        else:
            self.grant(self._reservations.want((run_id, wanted.step), wanted.robot), now)

    def hold(self, claim: Claim, robot: str) -> None:
        """A task has had its robot since before a restart."""
        self._reservations.want(claim, robot)

    def let_go(self, claim: Claim, now: float) -> None:
        """A run needs a robot no more, or waits for it no more."""
        self._anybody.pop(claim, None)
        self._told.pop(claim, None)
        self.grant(self._halts.let_go(claim), now)

    def end(self, run_id: str, steps: Iterable[str], now: float) -> None:
        """A run has ended: others get its robots, as far as they stand."""
        for step in steps:
            self._runs.guard(run_id, now, self.let_go, (run_id, step), now)

    def forget(self, run_id: str) -> None:
        """Look for nobody any more for a run; what it has it keeps."""
        self._anybody = {claim: waiting for claim, waiting in self._anybody.items() if claim[0] != run_id}
        self._told = {claim: told for claim, told in self._told.items() if claim[0] != run_id}

    def waiting(self) -> list[Claim]:
        """Tasks for which whoever can do them is looked for, or was found and has not begun."""
        return list(self._anybody)

    def next_deadline(self) -> float | None:
        """When the hope for a robot ends, or None."""
        return min((at for one in self._anybody.values() if (at := one.hope_until) is not None), default=None)

    def look_again(self, claim: Claim, now: float, is_free: bool = False) -> None:
        """Look again where nobody was there or free, or who was to do it cannot be asked now; `is_free`: a robot is
        that was not.
        """
        waiting = self._anybody.get(claim)
        if waiting is None:
            return
        run_id, step = claim
        run = self._runs.runs.get(run_id)
        if run is None or run.state.phase(step) is not TaskPhase.WANTED:
            del self._anybody[claim]
            return
        robot = self._reservations.robot_of(claim)
        if robot is not None and self._reservations.holder(robot) == claim:
            is_another_wanted = self._known.unfit(robot, self._known.needs(robot, run.task(step))) is not None
        else:
            is_late = waiting.hope_until is not None and now >= waiting.hope_until
            is_another_wanted = is_free or is_late or waiting.looked_at != self._seen(claim)
        if is_another_wanted:
            self._want_anybody(run_id, waiting.wanted, now)

    def _seen(self, claim: Claim) -> object:
        """What candidates for a task follow from, apart from who has them."""
        return self._choosing.moment(claim[0]), self._choosing.arguments(*claim)

    def touch(self, run_id: str, steps: Iterable[str]) -> None:
        """Something has happened to tasks: those that wait for their robots are told of it."""
        for step in steps:
            self._reservations.touch((run_id, step))

    def tell_queued(self, now: float) -> bool:
        """Tell tasks which others have the robots that they wait for, and have those that any could do take a robot
        that is free now. Whether any robot has come to another task since it was told last.
        """
        moved = self._reservations.take_moved()
        if any(self._reservations.holder(robot) is None for robot in moved):
            for claim in self.waiting():
                robot = self._reservations.robot_of(claim)
                if robot is not None and self._reservations.holder(robot) != claim:
                    self._runs.guard(claim[0], now, self.look_again, claim, now, True)
        for robot in moved:
            for claim in self._reservations.queued(robot):
                self._runs.guard(claim[0], now, self._tell_queued, claim, robot, now)
        return bool(moved)

    def _tell_queued(self, claim: Claim, robot: str, now: float) -> None:
        run_id, step = claim
        reason = self._taken_by(robot, run_id)
        if run_id in self._runs.runs and reason != self._told.get(claim, ""):
            self._told[claim] = reason
            is_for_any = claim in self._anybody
            self._runs.tell(run_id, now, Run.waits, step, reason, now, "" if is_for_any else robot)

    def _taken_by(self, robot: str, run_id: str) -> str:
        """What another run has a robot for, or what it has not stopped yet, for people; empty where it is the run's."""
        holder = self._reservations.holder(robot)
        if holder is None or holder[0] == run_id:
            return ""
        owner, step = holder
        run = self._runs.runs.get(owner)
        if (halt := self._halts.get(step)) is not None:
            return f"{robot} was told to stop {halt.what}, and has not said that it has"
        if run is None:
            return f"run {owner} has {robot}, and cannot be ended; restart the server"
        name, phase = run.task(step).name, run.state.phase(step)
        if phase is TaskPhase.ASKED:
            answer = f"ua-fleet scenario answer {owner} {name} done|retry|fail"
            return f"{robot} may still be at task {name} of run {owner}; say what became of it: {answer}"
        if run.state.closing is not None:
            return f"{robot} is to stop task {name} of run {owner}, which ends"
        has = f"{robot} {_DOES.get(phase, 'does')} task {name} of run {owner}"
        return f"{has}; ua-fleet scenario abort {owner} ends that run"

    def _promised(self) -> list[str]:
        """The robots of tasks that any could do; a task that names its robot is counted by its run."""
        return [robot for claim, robot in self._granted.items() if claim in self._anybody]

    def grant(self, grants: list[Grant[Claim]], now: float) -> None:
        """Tell runs of the robots that they have now, when nothing is left to carry out."""
        self._granted.update(grants)
        if grants:
            self._runs.go_on(now)

    def grant_next(self, now: float) -> bool:
        """Tell one run of a robot that it has now; whether there was one to be told of."""
        if not self._granted:
            return False
        claim = next(iter(self._granted))
        robot = self._granted.pop(claim)
        self._told.pop(claim, None)
        if self._reservations.holder(robot) == claim:  # and has not given it back since
            self._runs.guard(claim[0], now, self._grant_one, claim, robot, now)
        return True

    def _grant_one(self, claim: Claim, robot: str, now: float) -> None:
        run_id, step = claim
        run = self._runs.runs.get(run_id)
        if run is not None:
            skill = self._known.fleet.declared(robot, run.task(step).skill)
            self._runs.tell(run_id, now, Run.granted, step, robot, now, skill)

    def _want_anybody(self, run_id: str, wanted: WantRobot, now: float) -> None:
        claim = run_id, wanted.step
        seen = self._seen(claim)
        todo = self._choosing.wanted(run_id, wanted)
        ranking = self._choosing.ranked(todo)
        robot = self._chosen(ranking, claim)
        before = self._anybody.get(claim)
        if robot is not None:
            self._anybody[claim] = _Anybody(wanted, seen)
            if before is not None and before.since is not None:
                self._told.pop(claim, None)
                self._runs.tell(run_id, now, Run.waits, wanted.step, "", now)
            self.grant(self._reservations.want(claim, robot), now)
            return
        self.grant(self._reservations.release(claim), now)
        since = now if before is None or before.since is None else before.since
        hope_until = self._known.hope_until(todo, since, now)
        reasons = "; ".join(self._known.why_not(left.robot, left.reason, todo.task) for left in ranking.excluded)
        reason = f"no robot can do {wanted.skill}: {reasons or 'there is none'}"
        self._told.pop(claim, None)
        if hope_until is not None:
            self._anybody[claim] = _Anybody(wanted, seen, hope_until, since)
            self._runs.tell(run_id, now, Run.waits, wanted.step, reason, now)
            return
        self._anybody.pop(claim, None)
        self._runs.tell(run_id, now, Run.nobody, wanted.step, reason, now)

    def _chosen(self, ranking: Ranking, claim: Claim) -> str | None:
        """The best of those that no other task has; without such, the one that is waited for already, or the best."""
        ranked = [place.robot for place in ranking.ranked]
        free = (robot for robot in ranked if self._reservations.holder(robot) in (None, claim))
        waited_for = self._reservations.robot_of(claim)
        return next(free, waited_for if waited_for in ranked else ranking.best)
