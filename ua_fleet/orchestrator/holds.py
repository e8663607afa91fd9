"""Robots that people hold back from tasks of runs, until somebody releases them.

A held robot is one that cannot be had: what waits for it waits as for one that is in use. It keeps what it is at, and
people may still call its skills.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from ua_fleet.errors import ScenarioError
from ua_fleet.printing import utc_text

__all__ = ["Hold", "Holds"]


@dataclass(frozen=True, slots=True)
class Hold:
    """A robot that is held."""

    robot: str
    by: str
    since: float
    """By the wall clock, in seconds."""
    reason: str
    """Why, in the words of who holds it; may be empty."""

    @property
    def brief(self) -> str:
        """By whom since when and why, without the robot."""
        why = f" ({self.reason})" if self.reason else ""
        return f"is held by {self.by} since {utc_text(self.since)}{why}"

    @property
    def told(self) -> str:
        """The same with the robot, and the command that ends it, in one line for people."""
        return f"{self.robot} {self.brief}; when it may have tasks again, run: ua-fleet robot release {self.robot}"


class Holds:
    """All robots that are held, by their names."""

    def __init__(self) -> None:
        self._holds: dict[str, Hold] = {}

    def __iter__(self) -> Iterator[Hold]:
        return iter(list(self._holds.values()))

    def get(self, robot: str) -> Hold | None:
        """By whom a robot is held; None where it is not."""
        return self._holds.get(robot)

    def restore(self, holds: Iterable[Hold]) -> None:
        """Robots that were held before a restart are held."""
        self._holds.update({hold.robot: hold for hold in holds})

    def hold(self, robot: str, by: str, reason: str, now: float) -> Hold | None:
        """Hold a robot, or say another reason; None where that changes nothing.

        Raises:
            ScenarioError: somebody else holds it.
        """
        before = self._holds.get(robot)
        if before is not None and before.by != by:
            raise ScenarioError(f"{before.told}; then hold it")
        after = Hold(robot, by, now, reason) if before is None else replace(before, reason=reason)
        if after == before:
            return None
        self._holds[robot] = after
        return after

    def release(self, robot: str) -> Hold | None:
        """Give a robot back to the runs; None where it was not held."""
        return self._holds.pop(robot, None)
