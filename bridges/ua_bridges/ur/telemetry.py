"""Samples of the controller to the sources of `fleet.yaml`. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from ua_bridges.ur.config import UrSource, field_path
from ua_bridges.ur.state import State
from ua_bridges.ur.variables import ALWAYS_READ, VARIABLES, Reading, read_path, register_names
from ua_fleet.bridge.configured import configured_sources
from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound, SourceLost, SourceRead
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["Source", "Telemetry", "frequency_of", "sources_of", "variables_of"]

FASTEST_HZ: Final = 500.0
_LOST: Final = "samples came faster than they were read; this machine is too busy for the rate that is asked for"
LEAST_HZ: Final = 50.0
"""What skills and faults need."""


@dataclass(frozen=True)
class Source:
    """One DataSet that is read from the controller."""

    topic: Topic
    label: str
    fields: tuple[FieldMetaData, ...]
    readings: tuple[Reading, ...]
    max_rate_hz: float
    only_changes: bool
    is_aging: bool = False
    """Whether a reading that brings the same values counts, too."""


def sources_of(config: FleetConfig, bridge_name: str) -> tuple[Source, ...]:
    """The sources of the robot behind a bridge. What has no id yet, or no variable, is left out."""
    found: list[Source] = []
    for data in configured_sources(config, bridge_name, UrSource):
        readings = [read_path(field_path(name, field)) for name, field in data.config.all_fields().items()]
        known = tuple([reading for reading in readings if reading is not None])
        if len(known) == len(readings):
            source = data.side
            found.append(
                Source(
                    data.topic,
                    data.label,
                    data.fields,
                    known,
                    source.max_rate_hz,
                    source.only_changes,
                    data.is_aging,
                )
            )
    return tuple(found)


def variables_of(sources: tuple[Source, ...], registers: frozenset[tuple[str, int]]) -> dict[str, list[Any]]:
    """What has to be read: names in RTDE, each with the library's method and its arguments."""
    names = [*ALWAYS_READ, *[reading.name for source in sources for reading in source.readings]]
    names += [register_names(kind, place) for kind, place in sorted(registers)]
    read = [VARIABLES[name] for name in names]
    return {variable.rtde: [variable.getter, *variable.arguments] for variable in read}


def frequency_of(sources: tuple[Source, ...]) -> float:
    """How often the controller is asked to send: as often as the fastest source needs."""
    return min(max([LEAST_HZ, *[source.max_rate_hz for source in sources]]), FASTEST_HZ)


class Telemetry:
    """The sources while the connection comes and goes."""

    def __init__(self, sources: tuple[Source, ...], frequency_hz: float, put: Callable[[DriverEvent], None]) -> None:
        self._sources, self._put = sources, put
        self._half_cycle = 0.5 / frequency_hz
        self._due: dict[Topic, float] = {}
        self._last: dict[Topic, tuple[Any, ...]] = {}
        self._is_there = False
        self._told_lost = False

    def sampled(self, state: State, lost: int) -> None:
        """One sample, and how many were lost before it."""
        if lost:
            self._put(Dropped(Drop.INLET_FULL, lost, "" if self._told_lost else _LOST))
            self._told_lost = True
        if not self._is_there:
            self._is_there = True
            for source in self._sources:
                self._put(SourceFound(source.topic, source.label, source.fields))
        for source in self._sources:
            self._hand_on(source, state)

    def _hand_on(self, source: Source, state: State) -> None:
        due = self._due.get(source.topic)
        if due is not None and due - 1 / source.max_rate_hz <= state.time < due - self._half_cycle:
            return
        values = tuple([reading.of(state.values) for reading in source.readings])
        is_same = source.only_changes and self._last.get(source.topic) == values
        if is_same and not source.is_aging:
            return
        self._last[source.topic] = values
        # From the time that was due, not from now: 10 Hz out of 125 Hz would be less than 10 otherwise.
        period = 1 / source.max_rate_hz
        began = due if due is not None and 0 <= state.time - due < period else state.time
        self._due[source.topic] = began + period
        if is_same:
            self._put(SourceRead(source.topic, state.source_time_ns))
        else:
            self._put(SampleRead(source.topic, values, state.source_time_ns))

    def lost(self) -> None:
        """The connection is gone."""
        if self._is_there:
            self._is_there = self._told_lost = False
            self._due.clear()
            self._last.clear()
            for source in self._sources:
                self._put(SourceLost(source.topic))
