"""States and transitions of a program (OPC 10000-10 5.2.3, tables 6 and 8).

A skill shows what its latest execution is:

    execution                                   skill
    asked for, or under way                     Running
    the robot stands in the middle of it        Suspended
    done, refused, or too late to be begun      Ready
    failed, or nobody can tell                  Halted: look after the robot; Reset or the next Start makes it Ready
"""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple

from ua_fleet.skill.executions import OPEN, ExecutionState

__all__ = ["ProgramState", "Transition", "path", "state_of"]


class _Named(NamedTuple):
    node: int
    """Id of the state's or transition's node in the base namespace."""
    number: int


class ProgramState(_Named, Enum):
    """A state of ProgramStateMachineType."""

    READY = (2400, 12)
    RUNNING = (2402, 13)
    SUSPENDED = (2404, 14)
    HALTED = (2406, 11)

    @property
    def text(self) -> str:
        """As it is shown."""
        return self.name.capitalize()


class Transition(_Named, Enum):
    """A transition of ProgramStateMachineType."""

    HALTED_TO_READY = (2408, 1)
    READY_TO_RUNNING = (2410, 2)
    RUNNING_TO_HALTED = (2412, 3)
    RUNNING_TO_READY = (2414, 4)
    RUNNING_TO_SUSPENDED = (2416, 5)
    SUSPENDED_TO_RUNNING = (2418, 6)
    SUSPENDED_TO_HALTED = (2420, 7)
    SUSPENDED_TO_READY = (2422, 8)
    READY_TO_HALTED = (2424, 9)

    @property
    def text(self) -> str:
        """As it is shown, e.g. RunningToReady."""
        return "".join(part.capitalize() for part in self.name.split("_"))

    @property
    def ends(self) -> tuple[ProgramState, ProgramState]:
        """The states before and after it."""
        before, _, after = self.name.partition("_TO_")
        return ProgramState[before], ProgramState[after]


_BY_ENDS: Final = {transition.ends: transition for transition in Transition}


def path(before: ProgramState, after: ProgramState) -> tuple[Transition, ...]:
    """The transitions that lead from one state to another; there is no direct one from Halted to Running, say."""
    if before is after:
        return ()
    direct = _BY_ENDS.get((before, after))
    if direct is not None:
        return (direct,)
    if after is ProgramState.SUSPENDED:
        return (*path(before, ProgramState.RUNNING), Transition.RUNNING_TO_SUSPENDED)
    return (_BY_ENDS[before, ProgramState.READY], *path(ProgramState.READY, after))


def state_of(execution: ExecutionState) -> ProgramState:
    """What a skill shows while this is the state of its latest execution."""
    if execution is ExecutionState.SUSPENDED:
        return ProgramState.SUSPENDED
    if execution in OPEN:
        return ProgramState.RUNNING
    if execution in (ExecutionState.FAILED, ExecutionState.UNKNOWN):
        return ProgramState.HALTED
    return ProgramState.READY
