"""What the roster of robots needs of the rest of the server."""

from __future__ import annotations

from typing import Protocol

from ua_fleet.fleet.model import RobotModel
from ua_fleet.topics import Topic

__all__ = ["Taking"]


class Taking(Protocol):
    """The rest of the server, which takes robots in and lets them go."""

    def take_in(self, robot: RobotModel) -> None:
        """A robot has come."""
        ...

    def let_go(self, robot: RobotModel, *, is_replaced: bool) -> None:
        """A robot that does nothing is gone; or it comes again at once, with another definition."""
        ...

    def users_of(self, robot: RobotModel) -> list[str]:
        """What needs a robot now: executions and runs, for people."""
        ...

    def told_of(self, robot: RobotModel) -> list[str]:
        """What people say of a robot, and what takes it back: a hold, faults that they end."""
        ...

    def is_heard(self, robot: RobotModel) -> bool:
        """Whether its SkillStatus is alive."""
        ...

    def hears(self, topic: Topic) -> bool:
        """Whether a source is heard now, also one that belongs to no robot."""
        ...

    def stranger(self, ns: int, identifier: int) -> Topic | None:
        """The source that has an id and belongs to no robot or bridge."""
        ...
