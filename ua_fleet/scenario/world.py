"""What is known of the robots, as a run asks for it at each decision. Nothing of it is told to a run in some order."""

from __future__ import annotations

from collections.abc import Collection
from math import inf
from typing import NamedTuple, Protocol

from ua_fleet.scenario.model import Task

__all__ = ["AllWell", "RobotsView", "Trouble"]


class Trouble(NamedTuple):
    """Why a robot cannot do a task now."""

    reason: str
    stands: bool = False
    """Whether it is known to stand: what it was at is over. Else it has to be halted, and to say that it has."""
    told: str = ""
    """The same for people whose task it keeps from being begun: which fault, since when, and what ends it."""


class RobotsView(Protocol):
    """The robots as they are known now."""

    @property
    def silence_s(self) -> float:
        """So long a silent robot is waited for."""
        ...

    @property
    def return_s(self) -> float:
        """So long a silent robot is waited for that may be at a task with `on_unknown: retry`."""
        ...

    def needs(self, robot: str, task: Task) -> tuple[str, ...]:
        """The capacities that a task needs on a robot: those that it names, and those that its skill needs there."""
        ...

    def trouble(self, robot: str, needs: Collection[str] = ()) -> Trouble | None:
        """Why a robot must not be asked to do what needs some capacities; None where it may be. Without capacities: to
        do anything at all.
        """
        ...

    def silent_since(self, robot: str) -> float | None:
        """Since when nothing is heard of a robot, by the wall clock, the server's start at the earliest; None: it is
        heard.
        """
        ...

    def why_silent(self, robot: str) -> str:
        """What is known of why nothing is heard of a robot, and what to do, for people; may be empty."""
        ...

    def occupied(self, robot: str) -> str | None:
        """Why a robot is not free though no run has it: a person holds it, or it says that it is at what
        no run has asked for.
        """
        ...

    def followed_until(self, robot: str, execution_id: str) -> float:
        """Until when the robot's SkillStatus said that it is at an execution, by the wall clock: infinity while it says
        so, minus infinity if it never did. Its values may be lost meanwhile, so that it counts as silent.
        """
        ...


class AllWell:
    """Robots that are heard and have no faults."""

    silence_s = 30.0
    return_s = 300.0

    def needs(self, robot: str, task: Task) -> tuple[str, ...]:
        """See World."""
        del robot
        return task.capacities

    def trouble(self, robot: str, needs: Collection[str] = ()) -> Trouble | None:
        """See World."""
        del robot, needs
        return None

    def silent_since(self, robot: str) -> float | None:
        """See World."""
        del robot
        return None

    def why_silent(self, robot: str) -> str:
        """See World."""
        del robot
        return ""

    def occupied(self, robot: str) -> str | None:
        """See World."""
        del robot
        return None

    def followed_until(self, robot: str, execution_id: str) -> float:
        """See World."""
        del robot, execution_id
        return -inf
