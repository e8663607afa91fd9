"""Looks after halts that were ordered: robots are told again, and people of those about which no run asks."""

from __future__ import annotations

from collections.abc import Callable

from ua_fleet.orchestrator.claims import Claims
from ua_fleet.orchestrator.conditions import FaultFound
from ua_fleet.orchestrator.guard import Guard
from ua_fleet.orchestrator.halts import Halts
from ua_fleet.orchestrator.knowledge import Knowledge
from ua_fleet.orchestrator.outputs import Halt, HaltChanged, Output, TaskCancelled
from ua_fleet.scenario.consequences import NOT_HALTED

__all__ = ["Halting"]


class Halting:
    """What follows from halts, and from their ends."""

    def __init__(
        self,
        halts: Halts,
        known: Knowledge,
        claims: Claims,
        outputs: list[Output],
        guard: Guard,
        take_in: Callable[[FaultFound, float], None],
    ) -> None:
        """Connect the parts.

        Args:
            halts: those that are owed.
            known: the robots.
            claims: told of robots that are free.
            outputs: where it is told.
            guard: of each halt.
            take_in: has it known that a robot has a fault, or has it no more.
        """
        self._halts, self._known, self._claims, self._outputs, self._take_in = halts, known, claims, outputs, take_in
        self._guard = guard

    def order(self, halt: Halt) -> None:
        """A robot is to stop."""
        if self._halts.order(halt):
            self._outputs.append(HaltChanged(halt, is_owed=True))
        self._outputs.append(TaskCancelled(halt.execution_id, halt.robot, halt.skill))

    def settle(self, execution_id: str, now: float) -> bool:
        """A robot has stopped, or has ended what it was to stop, or a person says so; whether it was told to stop."""
        settled = self._halts.settle(execution_id)
        if settled is None:
            return False
        halt, grants = settled
        self._outputs.append(HaltChanged(halt, is_owed=False))
        if not self._halts.of(halt.robot):
            self._take_in(FaultFound(halt.robot, NOT_HALTED, False, ""), now)
        self._claims.grant(grants, now)
        return True

    def look_after(self, now: float) -> None:
        """Tell robots again that have not stopped, and people of those about which no run asks."""
        for halt in self._halts.all():
            self._guard.do("halts", self._look_whether_it_stands, halt, now)
        self._guard.do("halts", self._tell_again, now)
        self._guard.do("halts", self._ask_people, now)

    def _look_whether_it_stands(self, halt: Halt, now: float) -> None:
        trouble = self._known.trouble(halt.robot, self._known.fleet.needs(halt.robot, halt.skill))
        if trouble is not None and trouble.stands:
            self.settle(halt.execution_id, now)

    def _tell_again(self, now: float) -> None:
        self._outputs += self._halts.told_again(now)

    def _ask_people(self, now: float) -> None:
        for halt in self._halts.unanswered(now):
            if not any(fault.source == NOT_HALTED for fault in self._known.faults.active(halt.robot)):
                said = f"it was told to stop {halt.what}, and has not said that it has"
                self._guard.do("faults", self._take_in, FaultFound(halt.robot, NOT_HALTED, True, said), now)
