"""Halts that were ordered and not confirmed: nobody else gets the robots. Pure.

    (none)  order                                  owed: the robot is told, and told again in growing pauses
    owed    the robot's side says how it ended     (none)
    owed    the robot announces a fault: it stands (none)
    owed    a person says so (Answer, ClearFault)  (none)
    owed    its run lets the robot go, or ends     owed: the halt has the robot, and after HALT_S a fault asks people
    owed    restart                                owed: told again at once

Times are of the wall clock, since a halt outlives a process.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from ua_fleet.orchestrator.outputs import Halt, TaskCancelled
from ua_fleet.scenario import Grant, Reservations
from ua_fleet.scenario.consequences import HALT_S

__all__ = ["Halts"]

AGAIN_S: Final = 5.0
LONGEST_PAUSE_S: Final = 60.0
"""Before a robot is told again that has not stopped; the pause doubles each time."""
_NO_RUN: Final = ""
"""In the place of a run's id in the claims of halts."""

_Claim = tuple[str, str]


@dataclass(slots=True)
class _Owed:
    halt: Halt
    again_at: float
    pause_s: float = AGAIN_S


class Halts:
    """What robots were told to stop, and who has these robots."""

    def __init__(self, reservations: Reservations[_Claim]) -> None:
        """Look after the robots among all claims."""
        self._reservations = reservations
        self._owed: dict[str, _Owed] = {}
        self._looked_at = 0.0

    def order(self, halt: Halt) -> bool:
        """A robot is told to stop; whether that is new."""
        is_new = halt.execution_id not in self._owed
        if is_new:
            self._owed[halt.execution_id] = _Owed(halt, halt.since + AGAIN_S)
        return is_new

    def restore(self, halts: Iterable[Halt], now: float) -> None:
        """Take those of the process before; the claims of runs are there already."""
        for halt in halts:
            self._owed[halt.execution_id] = _Owed(halt, now)
            if self._reservations.holder(halt.robot) is None:
                self._reservations.want((_NO_RUN, halt.execution_id), halt.robot)

    def let_go(self, claim: _Claim) -> list[Grant[_Claim]]:
        """A run gives a robot back, or waits for it no more. A robot that has not stopped is not free."""
        robot = self._reservations.robot_of(claim) or ""
        halts = self.of(robot)
        if halts and self._reservations.holder(robot) == claim:
            self._reservations.hand_over(claim, (_NO_RUN, halts[0].execution_id))
            return []
        return self._reservations.release(claim)

    def settle(self, execution_id: str) -> tuple[Halt, list[Grant[_Claim]]] | None:
        """It is known what became of an execution, or a person says so; None where nothing was owed."""
        owed = self._owed.pop(execution_id, None)
        if owed is None:
            return None
        claim = _NO_RUN, execution_id
        grants = self.let_go(claim) if self._reservations.robot_of(claim) is not None else []
        return owed.halt, grants

    def get(self, execution_id: str) -> Halt | None:
        """The halt of an execution; None where none is owed."""
        owed = self._owed.get(execution_id)
        return None if owed is None else owed.halt

    def of(self, robot: str) -> list[Halt]:
        """Those that a robot has not confirmed."""
        return [owed.halt for owed in self._owed.values() if owed.halt.robot == robot]

    def all(self) -> list[Halt]:
        """Those that no robot has confirmed."""
        return [owed.halt for owed in self._owed.values()]

    def told_again(self, now: float) -> list[TaskCancelled]:
        """Whom to tell again now."""
        self._looked_at = now
        due = [owed for owed in self._owed.values() if now >= owed.again_at]
        for owed in due:
            owed.again_at = now + owed.pause_s
            owed.pause_s = min(2 * owed.pause_s, LONGEST_PAUSE_S)
        return [TaskCancelled(owed.halt.execution_id, owed.halt.robot, owed.halt.skill) for owed in due]

    def unanswered(self, now: float) -> list[Halt]:
        """Those of which no run asks any more, and that a person has to look after."""
        late = [owed.halt for owed in self._owed.values() if now >= owed.halt.since + HALT_S]
        return [halt for halt in late if self._reservations.robot_of((_NO_RUN, halt.execution_id)) is not None]

    def next_deadline(self) -> float | None:
        """When something is due, or None."""
        due = [owed.again_at for owed in self._owed.values()]
        due += [owed.halt.since + HALT_S for owed in self._owed.values()]
        return min((at for at in due if at > self._looked_at), default=None)
