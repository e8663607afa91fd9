"""What a run asks its owner to do. The owner carries them out in order, and tells the run what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ua_fleet.scenario.expression import Value
from ua_fleet.scenario.facts import Fact

__all__ = ["AskOperator", "CancelTask", "Effect", "Happened", "OpenDecision", "ReleaseRobot", "StartTask", "WantRobot"]


@dataclass(frozen=True, slots=True)
class Happened:
    """A fact was journaled: to be shown in nodes, and told as an event."""

    fact: Fact


@dataclass(frozen=True, slots=True)
class WantRobot:
    """A task waits for a robot: for the one that is named, or for any with the capacities. Answer: `granted`."""

    step: str
    task: str
    skill: str
    robot: str | None
    capacities: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ReleaseRobot:
    """A robot is no longer needed, or not waited for any more."""

    step: str


@dataclass(frozen=True, slots=True)
class StartTask:
    """Have a robot do something. Said again after a restart: the execution id makes it the same task."""

    step: str
    task: str
    execution_id: str
    robot: str
    skill: str
    arguments: Mapping[str, Value]
    timeout_s: float | None


@dataclass(frozen=True, slots=True)
class CancelTask:
    """Have a robot stop what it is at."""

    execution_id: str
    robot: str


@dataclass(frozen=True, slots=True)
class OpenDecision:
    """Somebody has to take a task over. Answer: `replaced` or `not_replaced`."""

    step: str
    task: str
    skill: str
    capacities: tuple[str, ...]
    robot: str
    """Which one failed; empty where none could be found in the first place."""
    reason: str


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Only a person can tell. Answer: `answered`; or `ended`, where the robot can tell after all."""

    step: str
    task: str
    robot: str
    question: str
    skill: str
    execution_id: str


Effect = Happened | WantRobot | ReleaseRobot | StartTask | CancelTask | OpenDecision | AskOperator
