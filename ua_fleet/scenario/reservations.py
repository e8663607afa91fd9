"""Who has which robot: one task at a time, served in the order in which they asked."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import Generic, NamedTuple, TypeVar

__all__ = ["Grant", "Reservations"]

Claim = TypeVar("Claim", bound=Hashable)
"""Names a task of a run, e.g. (run id, step)."""


class Grant(NamedTuple, Generic[Claim]):
    """A claim has its robot now."""

    claim: Claim
    robot: str


class Reservations(Generic[Claim]):
    """The claims on all robots. A claim is for one robot at a time."""

    def __init__(self) -> None:
        self._queues: dict[str, deque[Claim]] = {}
        """The first of each queue has the robot."""
        self._robots: dict[Claim, str] = {}
        self._moved: dict[str, None] = {}

    def want(self, claim: Claim, robot: str) -> list[Grant[Claim]]:
        """Ask for a robot. Asking again changes nothing, or says again what is granted; another robot replaces it."""
        before = self._robots.get(claim)
        if before == robot:
            return [Grant(claim, robot)] if self.holder(robot) == claim else []
        grants = self.release(claim)
        queue = self._queues.setdefault(robot, deque())
        queue.append(claim)
        self._robots[claim] = robot
        self._moved[robot] = None
        return [*grants, Grant(claim, robot)] if queue[0] == claim else grants

    def release(self, claim: Claim) -> list[Grant[Claim]]:
        """Give a robot back, or wait for it no more; who is served next."""
        robot = self._robots.pop(claim, None)
        if robot is None:
            return []
        queue = self._queues[robot]
        had = queue[0] == claim
        queue.remove(claim)
        self._moved[robot] = None
        if not queue:
            del self._queues[robot]
        elif had:
            return [Grant(queue[0], robot)]
        return []

    def hand_over(self, claim: Claim, to: Claim) -> None:
        """Have another claim stand where this one stands."""
        robot = self._robots.pop(claim)
        queue = self._queues[robot]
        queue[queue.index(claim)] = to
        self._robots[to] = robot
        self._moved[robot] = None

    def holder(self, robot: str) -> Claim | None:
        """Who has a robot."""
        queue = self._queues.get(robot)
        return queue[0] if queue else None

    def robot_of(self, claim: Claim) -> str | None:
        """The robot that a claim has, or waits for."""
        return self._robots.get(claim)

    def queued(self, robot: str) -> list[Claim]:
        """Who waits for a robot that another claim has, the next first."""
        return list(self._queues.get(robot, ()))[1:]

    def touch(self, claim: Claim) -> None:
        """Something has happened to a claim: who waits for its robot is among those of `take_moved`."""
        robot = self._robots.get(claim)
        if robot is not None and len(self._queues[robot]) > 1:
            self._moved[robot] = None

    def take_moved(self) -> list[str]:
        """The robots for which others wait, or of which others have them, since this was asked last."""
        moved = list(self._moved)
        self._moved.clear()
        return moved

    def tasks_ahead(self, robot: str) -> int:
        """How many claims a robot has to serve."""
        return len(self._queues.get(robot, ()))
