"""What a run asks its owner to do. The owner carries them out in order, and tells the run what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ua_fleet.scenario.expression import Value
from ua_fleet.scenario.facts import Fact

__all__ = [
    "AskOperator",
    "CancelTask",
    "DecisionNeeded",
    "Effect",
    "FollowTask",
    "Happened",
    "ReleaseRobot",
    "StartTask",
    "TaskWaits",
    "WantRobot",
]


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
class FollowTask:
    """Listen for what became of an execution, and have nobody begin it: said of one that may have been begun."""

    step: str
    execution_id: str
    robot: str
    skill: str
    may_be_unasked: bool = False
    """Whether the robot may never have been asked for it: then it has ended, as refused."""


@dataclass(frozen=True, slots=True)
class CancelTask:
    """Have a robot stop what it is at. It is not free before it says what became of that, or a person does."""

    execution_id: str
    robot: str
    skill: str


@dataclass(frozen=True, slots=True)
class TaskWaits:
    """Why a task cannot begin now, for people; said again when that changes."""

    step: str
    task: str
    skill: str
    robot: str
    """Empty where any robot will do."""
    reason: str
    """Empty: it waits for this no more."""


@dataclass(frozen=True, slots=True)
class DecisionNeeded:
    """Somebody has to take a task over. Answer: `replaced` or `not_replaced`."""

    step: str
    task: str
    skill: str
    capacities: tuple[str, ...]
    robot: str
    """Which one failed; empty where none could be found in the first place."""
    reason: str
    may_be_done: bool = False
    """Whether that one may have done it, and could not tell yet: the server was started anew meanwhile."""


@dataclass(frozen=True, slots=True)
class AskOperator:
    """Only a person can tell, or consent to another robot. Answer: `answered`, `replaced` or `not_replaced`; or `ended`
    or `accepted`, where the robot can tell after all.
    """

    step: str
    task: str
    robot: str
    question: str
    skill: str
    execution_id: str
    capacities: tuple[str, ...] = ()


Effect = (
    Happened | WantRobot | ReleaseRobot | StartTask | FollowTask | CancelTask | TaskWaits | DecisionNeeded | AskOperator
)
