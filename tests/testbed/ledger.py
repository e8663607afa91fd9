"""Commands that were asked for, held against what robots say that they have begun. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Account", "Begun", "Command", "Outcome", "account"]


class Outcome(StrEnum):
    """What a client was told in the end."""

    OPEN = "open"
    """It was accepted, and no end has been told."""
    DONE = "done"
    FAILED = "failed"
    REFUSED = "refused"
    """It was not begun, and never will be."""
    UNKNOWN = "unknown"
    """The robot cannot tell what became of it."""
    UNANSWERED = "unanswered"
    """The connection was lost before Start was answered: it may be begun or not."""


@dataclass(slots=True)
class Command:
    """One call of Start."""

    robot: str
    skill: str
    asked_at: float
    """Seconds since 1970."""
    execution_id: str = ""
    outcome: Outcome = Outcome.UNANSWERED
    ended_at: float = 0.0
    message: str = ""
    within_s: float = math.inf
    """The robot does not begin later than this after it was asked: the skill's timeout."""


@dataclass(frozen=True, slots=True)
class Begun:
    """A robot has begun something."""

    robot: str
    at: float
    """Seconds since 1970."""
    mark: str = ""
    """What tells it from all others at this robot, as far as the robot is told."""


@dataclass(frozen=True, slots=True)
class Account:
    """What became of the commands of a time."""

    asked: int = 0
    done: int = 0
    refused: int = 0
    failed: int = 0
    unknown: int = 0
    unanswered: int = 0
    lost: int = 0
    """Accepted without an end, or told to be done though the robot never began it."""
    doubled: int = 0
    """Begun more than once."""
    late: int = 0
    """Begun when its time was over."""

    def __add__(self, other: Account) -> Account:
        """Both."""
        return Account(*(getattr(self, name) + getattr(other, name) for name in Account.__dataclass_fields__))


CALL_S = 1.0
"""From a client's call to the server's request, on a machine that is busy."""
_SURELY_BEGUN = (Outcome.DONE,)
_NEVER_BEGUN = (Outcome.REFUSED,)


def account(commands: Sequence[Command], begun: Iterable[Begun]) -> Account:
    """Hold commands against what robots have begun in the same time.

    Args:
        commands: of all robots.
        begun: by all of them.
    """
    outcomes = Counter(command.outcome for command in commands)
    told_at = list(begun)
    told = Counter((one.robot, one.mark) for one in told_at)
    robots = {command.robot for command in commands} | {robot for robot, _ in told}
    doubled = dict.fromkeys(robots, 0)
    unseen = 0
    for (robot, mark), count in told.items():
        doubled[robot] += count - 1 if mark else 0
    for robot in robots:
        count = sum(number for (name, _), number in told.items() if name == robot)
        of_robot = [command for command in commands if command.robot == robot]
        # A failed one may have been begun or not: the way to the robot was lost.
        most = sum(command.outcome not in _NEVER_BEGUN for command in of_robot)
        least = sum(command.outcome in _SURELY_BEGUN for command in of_robot)
        doubled[robot] = max(doubled[robot], count - most)
        unseen += max(0, least - (count - doubled[robot]))
    return Account(
        asked=len(commands),
        done=outcomes[Outcome.DONE],
        refused=outcomes[Outcome.REFUSED],
        failed=outcomes[Outcome.FAILED],
        unknown=outcomes[Outcome.UNKNOWN],
        unanswered=outcomes[Outcome.UNANSWERED],
        lost=outcomes[Outcome.OPEN] + unseen,
        doubled=sum(doubled.values()),
        late=sum(_late(commands, told_at, robot) for robot in robots),
    )


def _late(commands: Sequence[Command], begun: Sequence[Begun], robot: str) -> int:
    """How many a robot has begun of which no command fits that was asked for in time.

    What nobody has asked for at all is doubled, and not late.
    """
    open_ = sorted(
        (each for each in commands if each.robot == robot and each.outcome not in _NEVER_BEGUN),
        key=lambda each: each.asked_at,
    )
    late = 0
    for one in sorted((one for one in begun if one.robot == robot), key=lambda one: one.at):
        asked = [each for each in open_ if each.asked_at <= one.at]
        in_time = [each for each in asked if one.at - each.asked_at <= each.within_s + CALL_S]
        if asked:
            open_.remove((in_time or asked)[0])
            late += not in_time
    return late
