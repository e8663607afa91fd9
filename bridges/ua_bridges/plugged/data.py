"""The data of the robots behind a bridge to plugged-in devices. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ua_bridges.plugged.config import PluggedSink, PluggedSource
from ua_fleet.bridge.driver import DriverEvent
from ua_fleet.config.base import ScalarType
from ua_fleet.config.schema import DataSetConfig, FleetConfig
from ua_fleet.fleet.skills import ArgumentModel, argument_problem
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["PluggedData", "Put", "as_type", "data_of", "field_types"]

Put = Callable[[DriverEvent], None]
_FLOATS = (ScalarType.FLOAT, ScalarType.DOUBLE)


@dataclass(frozen=True, slots=True)
class PluggedData:
    """One DataSet of a robot behind the bridge."""

    topic: Topic
    robot: str
    name: str
    types: Mapping[str, ScalarType]
    """Its fields by the names that patterns use: a single one is `value`."""
    mapping: PluggedSource | PluggedSink
    fields: tuple[FieldMetaData, ...]

    @property
    def label(self) -> str:
        """How it is named in a line for people."""
        return f"{self.robot}.{self.name}"


def field_types(data: DataSetConfig) -> dict[str, ScalarType]:
    """The fields of data by the names that templates and patterns use: a single one is `value`."""
    return {name or "value": field.type for name, field in data.all_fields().items()}


def data_of(config: FleetConfig, bridge_name: str) -> tuple[PluggedData, ...]:
    """The data of the robots behind a bridge, in both directions. What has no id yet is left out."""
    bridge = config.bridges[bridge_name]
    found: list[PluggedData] = []
    for robot_name, robot in config.robots.items():
        if robot.bridge != bridge_name:
            continue
        for name, data in robot.data.items():
            is_own = data.origin == "robot"
            mapping = data.source if is_own else data.sink
            if data.id is None or not isinstance(mapping, PluggedSource | PluggedSink):
                continue
            topic = Topic(bridge.space if is_own else SERVER_SPACE, config.fleet.namespace_index, data.id)
            fields = [make_field(field or name, each.type.builtin) for field, each in data.all_fields().items()]
            found.append(PluggedData(topic, robot_name, name, field_types(data), mapping, tuple(fields)))
    return tuple(found)


def as_type(name: str, kind: ScalarType, value: Any) -> Any:
    """A value as its field's type has it, a ValueError in its place where that cannot hold it."""
    if kind in _FLOATS and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    problem = argument_problem(ArgumentModel(name, int(kind.builtin)), value)
    return value if problem is None else ValueError(problem)
