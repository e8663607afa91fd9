"""What the orchestrator tells its owner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ua_fleet.orchestrator.faults import Fault, FaultChange
from ua_fleet.orchestrator.holds import Hold
from ua_fleet.resilience import DecisionEvent, Ranking
from ua_fleet.scenario import Value
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.facts import Fact

__all__ = [
    "BridgeTold",
    "BridgesFollowed",
    "DecisionChanged",
    "FaultChanged",
    "FaultForecast",
    "Halt",
    "HaltChanged",
    "HoldChanged",
    "OperatorAsked",
    "Output",
    "RunBroken",
    "RunChanged",
    "TaskCancelled",
    "TaskFollowed",
    "TaskStarted",
    "TaskWaiting",
]


@dataclass(frozen=True, slots=True)
class TaskStarted:
    """Send a request to a robot. Said again after a restart, with the same execution id."""

    run_id: str
    step: str
    task: str
    execution_id: str
    robot: str
    skill: str
    arguments: Mapping[str, Value]
    timeout_s: float | None


@dataclass(frozen=True, slots=True)
class TaskWaiting:
    """Why a task of a run cannot begin now, for people; it is written nowhere."""

    run_id: str
    waits: TaskWaits


@dataclass(frozen=True, slots=True)
class BridgeTold:
    """How a bridge of a carried run stands, as the server sees it."""

    state: str
    """`answers`, `away`, or `silent`: for so long that a person may leave it out."""
    has_token: bool
    """Whether it had one when it was heard last."""
    message: str
    """Why it cannot be asked or hand its token over; empty: it can."""


@dataclass(frozen=True, slots=True)
class BridgesFollowed:
    """How the bridges of a carried run stand, by their spaces; it is written nowhere."""

    run_id: str
    bridges: Mapping[int, BridgeTold]


@dataclass(frozen=True, slots=True)
class TaskFollowed:
    """Listen for what became of an execution; have nobody begin it."""

    execution_id: str
    robot: str
    skill: str
    may_be_unasked: bool
    """Whether the robot may never have been asked for it: then it has ended, as refused."""


@dataclass(frozen=True, slots=True)
class TaskCancelled:
    """Have a robot stop an execution; said again while it has not said that it has."""

    execution_id: str
    robot: str
    skill: str


@dataclass(frozen=True, slots=True)
class Halt:
    """A robot was told to stop an execution, or not to begin it."""

    execution_id: str
    robot: str
    skill: str
    since: float
    why: str = ""
    """Which task of which run it was at, and why it was told to stop, for people."""

    @property
    def what(self) -> str:
        """What the robot was told to stop, for people."""
        return f"{self.skill} ({self.why})" if self.why else self.skill


@dataclass(frozen=True, slots=True)
class HaltChanged:
    """A halt is owed from now on, also after a restart; or no more."""

    halt: Halt
    is_owed: bool


@dataclass(frozen=True, slots=True)
class HoldChanged:
    """A robot is held from tasks from now on, also after a restart; or no more."""

    hold: Hold
    is_held: bool
    by: str
    """Who has held or released it."""


@dataclass(frozen=True, slots=True)
class RunChanged:
    """A fact of a run."""

    run_id: str
    fact: Fact


@dataclass(frozen=True, slots=True)
class RunBroken:
    """A mistake of ours has ended a run, for the log."""

    run_id: str
    error: Exception


@dataclass(frozen=True, slots=True)
class DecisionChanged:
    """Something about a decision, with what it is about."""

    run_id: str
    step: str
    task: str
    failed: str
    reason: str
    event: DecisionEvent
    until: float | None = None
    """While it is open: when it is decided at the latest, by the wall clock; None where nobody knows."""


@dataclass(frozen=True, slots=True)
class OperatorAsked:
    """A person has to say what became of a task, unless its robot can tell after all."""

    run_id: str
    step: str
    task: str
    robot: str
    question: str
    skill: str
    execution_id: str


@dataclass(frozen=True, slots=True)
class FaultChanged:
    """A fault was raised, has changed, was cleared or acknowledged."""

    fault: Fault
    change: FaultChange


@dataclass(frozen=True, slots=True)
class FaultForecast:
    """What would happen to one task if a robot failed now; an answer, and no output."""

    run_id: str
    task: str
    ranking: Ranking


Output = (
    TaskStarted
    | TaskFollowed
    | TaskCancelled
    | TaskWaiting
    | BridgesFollowed
    | RunBroken
    | RunChanged
    | DecisionChanged
    | OperatorAsked
    | FaultChanged
    | HaltChanged
    | HoldChanged
)
