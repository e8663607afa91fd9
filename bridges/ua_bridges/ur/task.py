"""One execution on the controller: begun over the link, followed by what the controller says.

begin     tell the controller; raises a SkillError where it takes nothing, SkillTimeout where nobody can tell
resume    a bridge before us may have begun it; what is to be seen has to tell
look      with each state: how far it is, or how it ended
halt      have it stop; `look` tells of the end
"""

from __future__ import annotations

from typing import Final, NamedTuple, Protocol

from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.state import State, stop_of
from ua_fleet.bridge.executing import Ended
from ua_fleet.values import StatusCode

__all__ = [
    "BEGIN_S",
    "CANCELLED",
    "FAILED",
    "SETTLED_S",
    "SHOWN_S",
    "Forgotten",
    "Progress",
    "RobotTask",
    "Task",
    "Told",
    "stopped",
]

SETTLED_S: Final = 0.3
"""So long the arm has to stand before its place counts."""
BEGIN_S: Final = 3.0
"""A program that is sent says within this that it runs."""
SHOWN_S: Final = 1.0
"""What the dashboard server has agreed to shows within this."""
FAILED: Final = int(StatusCode.BAD_UNEXPECTED_ERROR)
CANCELLED: Final = int(StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT)


class Progress(NamedTuple):
    """It goes on."""

    fraction: float
    message: str = ""


class Forgotten(NamedTuple):
    """Nobody can tell what became of it."""

    message: str


Told = Progress | Ended | Forgotten | None


class RobotTask(Protocol):
    """See the module. `moves_arm`: only one such task is under way at a time."""

    moves_arm: bool
    is_told: bool
    """Whether the controller may have been told to begin."""
    is_unsure: bool
    """Whether nobody has said that it took it: what it shows has to tell."""

    def begin(self, link: CommandLink, state: State, now: float) -> None:
        """Tell the controller."""
        ...

    def resume(self, state: State, now: float) -> None:
        """Follow what may have been begun."""
        ...

    def look(self, link: CommandLink, state: State, now: float) -> Told:
        """What the controller shows; None where there is nothing new."""
        ...

    def check_can_halt(self) -> None:
        """Nothing where there is a way to stop it; raises SkillRejected where there is none."""
        ...

    def halt(self, link: CommandLink, state: State) -> None:
        """Have it stop, where `check_can_halt` lets it."""
        ...


class Task:
    """What all tasks begin with."""

    is_told = is_unsure = False

    def check_can_halt(self) -> None:
        """See RobotTask."""


def stopped(state: State) -> Ended | None:
    """The end of what the safety system has stopped, once the arm stands; only where `stop_of` says so."""
    return Ended(int(StatusCode.BAD_OUT_OF_SERVICE), (), stop_of(state)) if state.stands else None
