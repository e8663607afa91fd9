"""The data of a TCP robot: what it sends, and what it is sent. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from ua_bridges.tcp.config import FAULT, TcpSink, TcpSource
from ua_fleet.bridge.configured import ConfiguredData, configured_faults
from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound, SourceLost
from ua_fleet.config.base import ScalarType
from ua_fleet.config.schema import DataSetConfig, FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.fleet.skills import ArgumentModel, argument_problem
from ua_fleet.rate import RateLimit
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant

__all__ = ["Put", "RobotData", "Sources", "faults_of", "subtype_of", "unfit"]

Put = Callable[[DriverEvent], None]
_FLOATS: Final = (ScalarType.FLOAT, ScalarType.DOUBLE)
RobotData = ConfiguredData[TcpSource] | ConfiguredData[TcpSink]


def subtype_of(data: RobotData) -> str:
    """What the program on the robot calls it."""
    return data.side.subtype or data.name


def faults_of(config: FleetConfig, bridge_name: str) -> tuple[ConfiguredData[TcpSource], ...]:
    """The DataSets with which the robots behind a bridge say what is wrong with them."""
    fault = DataSetConfig(type=ScalarType.STRING)
    faults = configured_faults(config, bridge_name).items()
    return tuple([ConfiguredData(robot, FAULT, topic, fault, TcpSource()) for robot, topic in faults])


def unfit(data: RobotData, values: Sequence[Any]) -> str | None:
    """Why values cannot be those of a DataSet for the robot; None where they can."""
    if len(values) != len(data.types):
        return f"{len(values)} values for {len(data.types)} fields"
    for (name, wanted), value in zip(data.types.items(), values, strict=True):
        if wanted in _FLOATS and isinstance(value, float) and not math.isfinite(value):
            continue  # `nan` for a program; a command refuses it
        if (problem := argument_problem(ArgumentModel(name, int(wanted.builtin)), value)) is not None:
            return f"{name}: {problem}"
    return None


class Sources:
    """The sources that a robot's connection stands for: they are there while it is."""

    def __init__(self, put: Put) -> None:
        self._put = put
        self._there: set[Topic] = set()
        self._limits: dict[Topic, RateLimit[SampleRead]] = {}
        self._told: set[str] = set()
        """Mistakes that were told since they were last absent: a log needs each once."""

    def found(self, data: RobotData) -> None:
        """It can be heard (again)."""
        if data.topic not in self._there:
            self._there.add(data.topic)
            self._put(SourceFound(data.topic, data.label, data.fields))

    def lost(self, data: RobotData) -> None:
        """It cannot be heard any more."""
        if data.topic in self._there:
            self._there.remove(data.topic)
            self._leave(data.topic)

    def all_lost(self) -> None:
        """The connection is gone."""
        for topic in sorted(self._there):
            self._leave(topic)
        self._there.clear()
        self._told.clear()

    def _leave(self, topic: Topic) -> None:
        limit = self._limits.pop(topic, None)
        if limit is not None and (last := limit.drain()) is not None:
            self._put(last)
        self._put(SourceLost(topic))

    def turn(self, now: float) -> float | None:
        """Hand on what has waited for its turn; when the next one is due, None where none waits."""
        for limit in self._limits.values():
            if (sample := limit.pop(now)) is not None:
                self._put(sample)
        return min((limit.due for limit in self._limits.values() if limit.due is not None), default=None)

    def read(self, data: RobotData, values: Mapping[str, Any], now: float, time_ns: int) -> None:
        """One value; a field that is missing, or a ValueError in its place, is Bad."""
        read: list[Any] = []
        for name in data.types:
            value = values.get(name)
            if isinstance(value, ValueError) or value is None:
                read.append(Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_TYPE_MISMATCH))
                self.dropped(Drop.CONVERSION, f"{data.label}: {name}: {value or 'it is missing'}")
            else:
                read.append(value)
        sample = SampleRead(data.topic, tuple(read), time_ns)
        rate_hz = data.side.max_rate_hz if isinstance(data.side, TcpSource) else None
        if rate_hz is None:
            self._put(sample)
            return
        limit = self._limits.setdefault(data.topic, RateLimit(rate_hz))
        passed, is_replaced = limit.offer(sample, now)
        if is_replaced:
            self._put(Dropped(Drop.RATE_LIMITED))
        if passed is not None:
            self._put(passed)

    def dropped(self, cause: Drop, detail: str, count: int = 1) -> None:
        """Count what cannot be handed on; the same words are told once for each connection."""
        is_new = detail not in self._told and len(self._told) < 100
        if is_new:
            self._told.add(detail)
        self._put(Dropped(cause, count, detail if is_new else ""))
