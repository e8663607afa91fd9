"""What the state of the fleet tells: facts about nodes and sources, in the order in which they happened."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from ua_fleet.fleet.model import DataSetModel, RobotModel
from ua_fleet.topics import Topic
from ua_fleet.values import NodeId

__all__ = [
    "CapacitiesChanged",
    "Change",
    "Noticed",
    "RobotAdded",
    "RobotRemoved",
    "SourceAdded",
    "SourceQuarantined",
    "SourceReleased",
    "SourceRemoved",
    "ValueChanged",
]


class ValueChanged(NamedTuple):
    """A node has another value, status or time. A status that is Bad may stand beside the last value that was known."""

    key: NodeId
    type: int
    """Type code of the value; 0 where there is none."""
    value: Any
    status: int
    source_timestamp: int | None
    """Ticks."""
    can_wait: bool
    """An analog value of the same quality as the one before: of several in quick succession the last one will do."""


class SourceAdded(NamedTuple):
    """A source that `fleet.yaml` does not name gets nodes. Precedes its first ValueChanged."""

    data_set: DataSetModel


class SourceRemoved(NamedTuple):
    """The nodes of a source that had been added are gone, since its fields are others now."""

    data_set: DataSetModel


class SourceQuarantined(NamedTuple):
    """A source is listed without values."""

    topic: Topic
    name: str
    message_type: str
    reason: str


class SourceReleased(NamedTuple):
    """A source is not listed any more, since a robot has it now."""

    topic: Topic


class RobotAdded(NamedTuple):
    """A robot that `fleet.yaml` does not name gets nodes. Precedes the values of its sources."""

    robot: RobotModel


class RobotRemoved(NamedTuple):
    """The nodes of such a robot are gone."""

    robot: RobotModel


class CapacitiesChanged(NamedTuple):
    """A source that gives capacities has come or gone. Said also where another one gives the same."""

    robot: RobotModel
    holds: tuple[str, ...]
    """What the robot can do now."""
    lacks: Mapping[str, str]
    """What it could do but for a source that is not there, with the reason."""


class Noticed(NamedTuple):
    """Something for the log, said once until it has changed."""

    is_problem: bool
    text: str
    topic: Topic | None = None
    robot: str = ""
    """The robot that it is about, by its name."""
    bridge: str = ""
    """The bridge that it is about, by its name."""

    @property
    def ids(self) -> dict[str, str]:
        """What it is about, as the log names it."""
        topic = "" if self.topic is None else self.topic.name
        named = {"bridge": self.bridge, "robot": self.robot, "topic": topic}
        return {name: value for name, value in named.items() if value}


Change = (
    ValueChanged
    | SourceAdded
    | SourceRemoved
    | SourceQuarantined
    | SourceReleased
    | RobotAdded
    | RobotRemoved
    | CapacitiesChanged
    | Noticed
)
