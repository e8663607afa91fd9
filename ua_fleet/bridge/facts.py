"""What drivers tell: of the data sources of their space, and of what robots do. Facts, in the past tense."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import FieldMetaData

__all__ = [
    "DriverEvent",
    "Dropped",
    "ExecutionEnded",
    "ExecutionFact",
    "ExecutionForgotten",
    "ExecutionNotBegun",
    "ExecutionProgressed",
    "ExecutionResumed",
    "ExecutionSuspended",
    "SampleRead",
    "SourceForgotten",
    "SourceFound",
    "SourceLost",
    "SourceRead",
]


@dataclass(frozen=True, slots=True)
class SourceFound:
    """A data source of the own space is there (again) and alive; its fields are known.

    Precedes its samples. Said again when the fields change, and when a lost source comes back.
    """

    topic: Topic
    name: str
    """Name for people: the mapped robot's topic, or the UA topic itself."""
    fields: tuple[FieldMetaData, ...]
    """The first field carries the properties `RosType` and, from ROS 1, `RosDefinition`."""
    may_have_period: bool = False
    """Whether a maximum age is learned from the period of its messages, where none is configured: each of them says
    what is now, and no late subscriber gets the last one."""


@dataclass(frozen=True, slots=True)
class SourceLost:
    """The source's own publisher is gone: one Bad_NoCommunication frame follows, then silence."""

    topic: Topic


@dataclass(frozen=True, slots=True)
class SourceForgotten:
    """A source that was lost is not looked for any more, and nothing of it is kept. SourceFound makes it anew."""

    topic: Topic


class SampleRead(NamedTuple):
    """One message of a source. `values` are in the order of the fields of its SourceFound."""

    topic: Topic
    values: tuple[Any, ...]
    source_time_ns: int
    """The robot's time of the message, ns since 1970."""
    status: int = 0
    own_publication: bool = False
    """Whether this bridge itself had published it into the space."""
    waited_s: float = 0.0
    """How long it had waited for the driver's callback, where the driver can tell."""


@dataclass(frozen=True, slots=True)
class SourceRead:
    """A polled source was read, and says what its last SampleRead said: that value is of now.

    Only sources with a maximum age need it (`ConfiguredData.is_aging`).
    """

    topic: Topic
    source_time_ns: int
    """When it was read, ns since 1970."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """The driver could not hand on `count` messages."""

    cause: Drop
    count: int = 1
    detail: str = ""


class ExecutionProgressed(NamedTuple):
    """How far a robot is with an execution. Also the answer to `query` where it works on it."""

    execution_id: bytes
    progress: float = 0.0
    """0 to 1."""
    message: str = ""
    """One line for people."""


class ExecutionSuspended(NamedTuple):
    """A robot stands in the middle of an execution. Also the answer to `query` where it does."""

    execution_id: bytes
    message: str = ""
    """One line for people."""


class ExecutionResumed(NamedTuple):
    """A robot that stood goes on with an execution."""

    execution_id: bytes


class ExecutionEnded(NamedTuple):
    """An execution is over. Said once, by whatever means the robot tells; also the answer to `query` where it is."""

    execution_id: bytes
    status: int = 0
    """StatusCode; 0 where the robot did what was asked."""
    values: tuple[Any, ...] = ()
    """The response's fields; empty where the robot failed, or with an Uncertain status where they are not known."""
    message: str = ""
    """One line for people: why it failed."""


class ExecutionForgotten(NamedTuple):
    """The answer to `query` where the robot cannot tell what became of an execution."""

    execution_id: bytes
    message: str = ""
    """One line for people: why it cannot."""


class ExecutionNotBegun(NamedTuple):
    """The answer to `query` where the robot knows for sure that it never heard of an execution.

    It is begun then, if it is not too late. Only a robot that forgets nothing may be said to know that.
    """

    execution_id: bytes


ExecutionFact = (
    ExecutionProgressed
    | ExecutionSuspended
    | ExecutionResumed
    | ExecutionEnded
    | ExecutionForgotten
    | ExecutionNotBegun
)
DriverEvent = SourceFound | SourceLost | SourceForgotten | SampleRead | SourceRead | Dropped | ExecutionFact
