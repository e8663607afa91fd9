"""Which components of a PubSubConnection are enabled, and what their states were (OPC 10000-14 6.2.1 and 9.1.11.2).

A component is named by its way down from the PubSubConnection:

    ()                     the PubSubConnection
    ("W", ns)              the WriterGroup with this WriterGroupId
    ("W", ns, id)          one of its DataSetWriters
    ("R", space)           the ReaderGroup of what a publisher sends
    ("R", space, ns, id)   one of its DataSetReaders

                      itself enabled    itself disabled
    parent works      Operational       Disabled
    parent does not   Paused            Disabled

All are enabled at first. A component that nobody has disabled has no record here: what became of it follows from its
parent. So the memory is that of the components that somebody has switched, and not that of all DataSetWriters.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ua_fleet.errors import UaFleetError
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.discovered import PubSubState

__all__ = [
    "CONNECTION",
    "Component",
    "Components",
    "StateCounts",
    "StateInvalid",
    "parent_of",
    "reader",
    "reader_group",
    "writer",
    "writer_group",
]

Component = tuple[str | int, ...]

CONNECTION: Final[Component] = ()


def writer_group(ns: int) -> Component:
    """A WriterGroup."""
    return "W", ns


def writer(ns: int, writer_id: int) -> Component:
    """A DataSetWriter."""
    return "W", ns, writer_id


def reader_group(space: int) -> Component:
    """The ReaderGroup of what a publisher sends."""
    return "R", space


def reader(topic: Topic) -> Component:
    """The DataSetReader of a source."""
    return ("R", *topic)


def parent_of(component: Component) -> Component | None:
    """What a component pauses with; None for the PubSubConnection."""
    if not component:
        return None
    return component[:2] if len(component) > len(reader_group(0)) else CONNECTION


class StateInvalid(UaFleetError):
    """A component is disabled already, or enabled."""

    ua_status = StatusCode.BAD_INVALID_STATE
    remedy = "Read its Status.State first."


class StateCounts(NamedTuple):
    """How often a component changed its state, by the names of PubSubDiagnosticsType."""

    operational_by_method: int = 0
    operational_by_parent: int = 0
    paused_by_parent: int = 0
    disabled_by_method: int = 0


@dataclass(slots=True)
class _Record:
    """A component that was switched. Its counts are those up to the moment at which its parent's were `seen`."""

    is_enabled: bool = True
    counts: StateCounts = field(default_factory=StateCounts)
    stops: int = 0
    """How often it went from Operational to another state, and ..."""
    starts: int = 0
    """... from another state to Operational."""
    seen: tuple[int, int] = (0, 0)
    """Stops and starts of its parent."""


class Components:
    """The states of one PubSubConnection and of what is below it."""

    def __init__(self) -> None:
        self._records: dict[Component, _Record] = {}
        self.is_whole = True
        """Whether all components are enabled: then nobody has to ask for one."""

    def is_enabled(self, component: Component) -> bool:
        """Whether a component is enabled itself."""
        record = self._records.get(component)
        return record is None or record.is_enabled

    def is_operational(self, component: Component) -> bool:
        """Whether a component sends or takes anything."""
        above: Component | None = component
        while above is not None:
            if not self.is_enabled(above):
                return False
            above = parent_of(above)
        return True

    def state(self, component: Component) -> PubSubState:
        """The state of a component that has no error."""
        if not self.is_enabled(component):
            return PubSubState.DISABLED
        return PubSubState.OPERATIONAL if self.is_operational(component) else PubSubState.PAUSED

    def disable(self, component: Component) -> None:
        """Disable a component that is not Disabled; raises StateInvalid."""
        record = self._settled(component)
        if not record.is_enabled:
            raise StateInvalid("it is Disabled already")
        record.stops += self.is_operational(component)
        record.is_enabled = self.is_whole = False
        counts = record.counts
        record.counts = counts._replace(disabled_by_method=counts.disabled_by_method + 1)

    def enable(self, component: Component) -> None:
        """Enable a component that is Disabled; raises StateInvalid."""
        record = self._settled(component)
        if record.is_enabled:
            raise StateInvalid("it is not Disabled")
        record.is_enabled = True
        counts = record.counts
        if self.is_operational(component):
            record.starts += 1
            record.counts = counts._replace(operational_by_method=counts.operational_by_method + 1)
        else:
            record.counts = counts._replace(paused_by_parent=counts.paused_by_parent + 1)
        self.is_whole = all(each.is_enabled for each in self._records.values())

    def counts(self, component: Component) -> StateCounts:
        """How often a component changed its state."""
        record = self._records.get(component)
        if record is not None:
            return self._settled(component).counts
        stops, starts = self._moves(parent_of(component))
        return StateCounts(operational_by_parent=starts, paused_by_parent=stops)

    def _moves(self, component: Component | None) -> tuple[int, int]:
        """Stops and starts of a component; nothing moves above the PubSubConnection."""
        if component is None:
            return 0, 0
        if component not in self._records:
            return self._moves(parent_of(component))
        record = self._settled(component)
        return record.stops, record.starts

    def _settled(self, component: Component) -> _Record:
        """The record of a component, with what its parent did since it was looked at last."""
        above = self._moves(parent_of(component))
        record = self._records.get(component)
        if record is None:
            stops, starts = above
            counts = StateCounts(operational_by_parent=starts, paused_by_parent=stops)
            record = self._records[component] = _Record(counts=counts, stops=stops, starts=starts, seen=above)
            return record
        if record.is_enabled:
            stops, starts = above[0] - record.seen[0], above[1] - record.seen[1]
            record.stops += stops
            record.starts += starts
            counts = record.counts
            record.counts = counts._replace(
                operational_by_parent=counts.operational_by_parent + starts,
                paused_by_parent=counts.paused_by_parent + stops,
            )
        record.seen = above
        return record
