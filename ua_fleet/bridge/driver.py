"""The driver protocol: the part of a bridge that talks the robots' own language.

A driver tells what it hears through the `Inlet` (from any thread) as the facts below, and is told what to publish
into its space through `publish`. It knows nothing of datagrams, sequence numbers or the loop rule.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldMetaData

__all__ = [
    "Driver",
    "DriverEvent",
    "DriverStatus",
    "Dropped",
    "Inlet",
    "SampleRead",
    "SourceFound",
    "SourceLost",
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


@dataclass(frozen=True, slots=True)
class SourceLost:
    """The source's own publisher is gone: one Bad_NoCommunication frame follows, then silence."""

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


@dataclass(frozen=True, slots=True)
class Dropped:
    """The driver could not hand on `count` messages."""

    cause: Drop
    count: int = 1
    detail: str = ""


DriverEvent = SourceFound | SourceLost | SampleRead | Dropped


@dataclass(frozen=True, slots=True)
class DriverStatus:
    """State of the driver's link to its space."""

    connected: bool
    detail: str
    """One line: what it is connected to, or why it is not and what to do."""


class Inlet(Protocol):
    """The one bounded queue between a driver's threads and the bridge's event loop."""

    def put(self, event: DriverEvent) -> None:
        """Hand over an event; callable from any thread, never blocks.

        When full, the oldest SampleRead is dropped and counted; the other facts are never dropped.
        """
        ...


class Driver(Protocol):
    """Four methods; all but the inlet's `put` run in the bridge's event loop and must not block it."""

    async def start(self, inlet: Inlet) -> None:
        """Begin to watch the space. Returns once the driver works by itself, connected or not.

        A space that is absent (a ROS master that is not up) is not an error: the driver keeps trying and says so in
        `status`.

        Raises:
            BridgeUnavailable: a library that the driver needs is missing.
        """
        ...

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """Publish another space's message into this space; False, after an inlet Dropped, when that is not possible."""
        ...

    def status(self) -> DriverStatus:
        """The state of the link now."""
        ...

    async def stop(self) -> None:
        """Leave the space and release everything. Safe to call twice."""
        ...
