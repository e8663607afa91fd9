"""A small fleet, and the events that a subscriber would tell of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import FleetConfig, UnknownSources
from ua_fleet.counters import Counters
from ua_fleet.fleet import Change, FleetState, Noticed, ValueChanged
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMessage, DataSetMetaData, FieldMetaData

DOUBLE = int(BuiltinType.DOUBLE)
FLOAT = int(BuiltinType.FLOAT)
INT32 = int(BuiltinType.INT32)
STRING = int(BuiltinType.STRING)
BOOLEAN = int(BuiltinType.BOOLEAN)
STATUS = int(BuiltinType.STATUS_CODE)

ROBOTS: Mapping[str, Any] = {
    "rover": {
        "bridge": "mobile",
        "capacities": ["mobile"],
        "data": {
            "speed": {"id": 1001, "type": "Double", "range": [-2, 2]},
            "busy": {"id": 1002, "type": "Boolean"},
            "pose": {"id": 1003, "fields": {"x": {"type": "Double"}, "frame": {"type": "String"}}},
            "ranges": {"id": 1004, "type": "Float", "array": True},
            "count": {"id": 1005, "type": "Int32"},
            "goal": {"id": 1006, "type": "Double", "origin": "server", "range": [0, 1], "initial": 0},
        },
    }
}
SPEED, BUSY, POSE, RANGES, COUNT = (Topic(2, 2, 1001 + index) for index in range(5))
BRIDGE = Topic(2, 2, 1900)


def fleet_config(robots: Mapping[str, Any] = ROBOTS) -> FleetConfig:
    return FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"mobile": {"kind": "ros2", "space": 2, "status_id": BRIDGE.id}},
            "robots": robots,
        }
    )


def metadata_of(*fields: FieldMetaData, name: str = "source", version: int = 1) -> DataSetMetaData:
    return DataSetMetaData(name, fields, ConfigurationVersion(version, version))


METADATA: Mapping[Topic, DataSetMetaData] = {
    SPEED: metadata_of(make_field("data", DOUBLE)),
    BUSY: metadata_of(make_field("data", BOOLEAN)),
    POSE: metadata_of(make_field("frame", STRING), make_field("x", DOUBLE)),
    RANGES: metadata_of(make_field("data", FLOAT, array=True)),
    COUNT: metadata_of(make_field("data", INT32)),
    BRIDGE: metadata_of(make_field("Connected", BOOLEAN), make_field("MessagesIn", BuiltinType.UINT64)),
}


def message(
    types: Sequence[int], values: Sequence[Any], timestamp: int | None = 1, status: int | None = None, **more: Any
) -> DataSetMessage:
    return DataSetMessage(1, types=tuple(types), values=tuple(values), timestamp=timestamp, status=status, **more)


class Fleet:
    """A state with shortcuts. `now` is the wall clock in ticks."""

    def __init__(self, policy: UnknownSources = UnknownSources.QUARANTINE, *, max_sources: int = 1000) -> None:
        self.counters = Counters()
        self.model = fleet_model(fleet_config())
        self.state = FleetState(self.model, self.counters, unknown_sources=policy, max_discovered_sources=max_sources)
        self.now = 1000

    def hear(
        self, topic: Topic, types: Sequence[int], values: Sequence[Any], timestamp: int = 1, **more: Any
    ) -> list[Change]:
        metadata = more.pop("metadata", None) or METADATA[topic]
        return self.state.apply(DataReceived(topic, message(types, values, timestamp, **more), metadata), self.now)

    def speed(self, value: Any, timestamp: int = 1, **more: Any) -> list[Change]:
        return self.hear(SPEED, [DOUBLE], [value], timestamp, **more)


def values(changes: Sequence[Change]) -> dict[int | str, tuple[Any, int, int | None]]:
    """Value, status and time of each node that changed, by identifier."""
    found: dict[int | str, tuple[Any, int, int | None]] = {}
    for change in changes:
        if isinstance(change, ValueChanged):
            assert isinstance(change.key.identifier, int | str)
            found[change.key.identifier] = (change.value, change.status, change.source_timestamp)
    return found


def notices(changes: Sequence[Change]) -> list[str]:
    return [change.text for change in changes if isinstance(change, Noticed)]


def key(identifier: int | str) -> NodeId:
    return NodeId(2, identifier)


FLOATS = FLOAT | ARRAY
