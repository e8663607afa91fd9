"""The nodes that stand for a fleet, as `fleet.yaml` and announced metadata describe them.

A node's key is its NodeId. The numeric id belongs to the DataSet: with one field the Variable has it, with several an
Object has it and its field Variables have the string ids `<id>.<field>`. Everything else has a stable string id.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from ua_fleet.config.schema import BridgeConfig, DataSetConfig, FleetConfig, RobotConfig, ScalarType
from ua_fleet.counters import Drop
from ua_fleet.errors import ConfigError, ConfigInvalid
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId

__all__ = [
    "BRIDGE_FIELDS",
    "FIRST_GROUP",
    "GROUP_SIZE",
    "TRAFFIC_FIELDS",
    "BridgeModel",
    "DataSetModel",
    "FieldModel",
    "FleetModel",
    "RobotModel",
    "RobotState",
    "drop_field",
]

GROUP_SIZE: Final = 100
"""Most children of one folder: asyncua and clients alike go through all of them for each."""
FIRST_GROUP: Final = "G00"

TRAFFIC_FIELDS: Final = ("MessagesIn", "MessagesOut", "Gaps", "Looped")
"""Variables of TrafficType beside its drops."""
BRIDGE_FIELDS: Final[tuple[tuple[str, BuiltinType], ...]] = (
    ("Connected", BuiltinType.BOOLEAN),
    ("Detail", BuiltinType.STRING),
    ("FromSpace", BuiltinType.UINT64),
    ("ToSpace", BuiltinType.UINT64),
    *((name, BuiltinType.UINT64) for name in TRAFFIC_FIELDS),
)
"""Fields of a bridge's status DataSet that BridgeType shows, beside its drops."""


_INTEGER_LIMITS: Final[dict[int, tuple[int, int]]] = {
    kind: (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    for kind, bits, signed in (
        (BuiltinType.SBYTE, 8, True),
        (BuiltinType.BYTE, 8, False),
        (BuiltinType.INT16, 16, True),
        (BuiltinType.UINT16, 16, False),
        (BuiltinType.INT32, 32, True),
        (BuiltinType.UINT32, 32, False),
        (BuiltinType.INT64, 64, True),
        (BuiltinType.UINT64, 64, False),
    )
}
"""Least and greatest value of each integer type (OPC 10000-6 table 1)."""


class RobotState(IntEnum):
    """RobotStateEnumeration of the UaFleet nodeset."""

    OFFLINE = 0
    IDLE = 1
    BUSY = 2
    FAULTED = 3


def drop_field(cause: str) -> str:
    """The field of a status DataSet that counts a cause."""
    return f"Drops.{cause}"


@dataclass(frozen=True, slots=True)
class FieldModel:
    """One field of a DataSet: one Variable."""

    key: NodeId
    name: str
    """Name of the field in the DataSet's metadata."""
    type: int
    """Type code of its values."""
    unit: str | None = None
    range: tuple[float, float] | None = None
    length: int = 0
    """Elements that an array has; 0 is any number."""
    initial: Any = None
    path: str | None = None


@dataclass(frozen=True, slots=True)
class DataSetModel:
    """One data source."""

    topic: Topic
    """Its space is where the data originates."""
    name: str
    fields: tuple[FieldModel, ...]
    description: str = ""
    is_single: bool = True
    """Whether the DataSet is a Variable; otherwise it is an Object with a Variable for each field."""
    message_type: str | None = None
    """Type of the robot's own topic that clients' data is written to, as `pkg/Name`."""

    @property
    def key(self) -> NodeId:
        """The node that has the DataSet's numeric id."""
        return NodeId(self.topic.ns, self.topic.id)

    @property
    def writable(self) -> bool:
        """Whether clients may write it: only what originates in the server."""
        return self.topic.space == SERVER_SPACE


@dataclass(frozen=True, slots=True)
class RobotModel:
    """One robot."""

    name: str
    bridge: str
    description: str
    capacities: tuple[str, ...]
    data_sets: tuple[DataSetModel, ...]
    ns: int

    @property
    def key(self) -> NodeId:
        """The robot's object."""
        return NodeId(self.ns, f"Robots.{self.name}")

    def part(self, name: str) -> NodeId:
        """A node of the robot that is no DataSet, e.g. State."""
        return NodeId(self.ns, f"Robots.{self.name}.{name}")


@dataclass(frozen=True, slots=True)
class BridgeModel:
    """One bridge and its status DataSet."""

    name: str
    kind: str
    space: int
    description: str
    status: DataSetModel | None
    """None where `fleet.yaml` gives the bridge no `status_id`."""
    ns: int

    @property
    def key(self) -> NodeId:
        """The bridge's object; it has the numeric id of its status DataSet."""
        return self.status.key if self.status is not None else NodeId(self.ns, f"Bridges.{self.name}")

    def part(self, name: str) -> NodeId:
        """A node of the bridge's object."""
        owner = f"Bridges.{self.name}" if self.status is None else str(self.status.topic.id)
        return NodeId(self.ns, f"{owner}.{name}")


@dataclass(frozen=True, slots=True)
class FleetModel:
    """All that the server shows of a fleet before anything has been heard of it."""

    name: str
    ns: int
    robots: tuple[RobotModel, ...]
    bridges: tuple[BridgeModel, ...]

    @classmethod
    def from_config(cls, config: FleetConfig) -> FleetModel:
        """The model of a checked `fleet.yaml`.

        Raises:
            ConfigInvalid: a DataSet has no id yet, or an id is given twice.
        """
        ns = config.fleet.namespace_index
        problems: list[ConfigError] = []
        bridges = tuple(_bridge(ns, name, bridge) for name, bridge in config.bridges.items())
        robots = tuple(
            _robot(ns, name, robot, config.space_of(name), problems) for name, robot in config.robots.items()
        )
        model = cls(config.fleet.name, ns, robots, bridges)
        owners: dict[NodeId, str] = {}
        for data_set in model.data_sets():
            first = owners.setdefault(data_set.key, data_set.name)
            if first is not data_set.name:
                problem = f"id {data_set.topic.id} is given to {first} and to {data_set.name}"
                problems.append(ConfigError(problem, suggestion="give one of them another id"))
        if problems:
            raise ConfigInvalid(problems)
        return model

    def data_sets(self) -> Iterator[DataSetModel]:
        """All configured DataSets, those of the bridges' status included."""
        for robot in self.robots:
            yield from robot.data_sets
        for bridge in self.bridges:
            if bridge.status is not None:
                yield bridge.status

    def traffic(self, name: str) -> NodeId:
        """A node of the server's own TrafficType object."""
        return NodeId(self.ns, f"Fleet.Traffic.{name}")


def _bridge(ns: int, name: str, config: BridgeConfig) -> BridgeModel:
    status = None
    if config.status_id is not None:
        topic = Topic.checked(config.space, ns, config.status_id)
        names = [*BRIDGE_FIELDS, *((drop_field(drop.value), BuiltinType.UINT64) for drop in Drop)]
        fields = tuple(FieldModel(NodeId(ns, f"{topic.id}.{field}"), field, int(kind)) for field, kind in names)
        status = DataSetModel(topic, name, fields, config.description, is_single=False)
    return BridgeModel(name, config.kind, config.space, config.description, status, ns)


def _robot(ns: int, name: str, config: RobotConfig, space: int, problems: list[ConfigError]) -> RobotModel:
    data_sets: list[DataSetModel] = []
    for browse_name, data_set in config.data.items():
        if data_set.id is None:
            problems.append(
                ConfigError(
                    "the DataSet has no id",
                    key=f"robots.{name}.data.{browse_name}",
                    suggestion="run: ua-fleet config assign-ids",
                )
            )
            continue
        origin = SERVER_SPACE if data_set.origin == "server" else space
        made = _data_set(Topic.checked(origin, ns, data_set.id), browse_name, data_set)
        for field in made.fields:
            if field.initial is not None and not _fits_initial(field):
                text = f"initial {field.initial!r} does not fit {field.name}"
                key = f"robots.{name}.data.{browse_name}"
                problems.append(ConfigError(text, key=key, suggestion="give a value of its type and range"))
        data_sets.append(made)
    return RobotModel(name, config.bridge, config.description, config.capacities, tuple(data_sets), ns)


def _data_set(topic: Topic, name: str, config: DataSetConfig) -> DataSetModel:
    is_single = not config.fields
    origin_is_server = topic.space == SERVER_SPACE
    fields = tuple(
        FieldModel(
            NodeId(topic.ns, topic.id if is_single else f"{topic.id}.{field_name}"),
            field_name or name,
            int(field.type.builtin) | (ARRAY if field.array else 0),
            field.unit,
            field.range,
            initial=_initial(field.initial, field.type) if origin_is_server else None,
            path=field.path,
        )
        for field_name, field in config.all_fields().items()
    )
    message_type = config.sink.type.replace("/msg/", "/") if config.sink is not None else None
    return DataSetModel(topic, name, fields, config.description, is_single, message_type)


def _initial(value: Any, wanted: ScalarType) -> Any:
    """YAML writes 0 where a Double is meant."""
    is_float = wanted in (ScalarType.FLOAT, ScalarType.DOUBLE)
    return float(value) if is_float and isinstance(value, int) and not isinstance(value, bool) else value


def _fits_initial(field: FieldModel) -> bool:
    """Whether a configured first value has the field's type and range."""
    value, kind = field.initial, field.type
    if kind in _INTEGER_LIMITS:
        low, high = _INTEGER_LIMITS[kind]
        fits = isinstance(value, int) and not isinstance(value, bool) and low <= value <= high
    elif kind in (BuiltinType.FLOAT, BuiltinType.DOUBLE):
        fits = isinstance(value, float)
    elif kind == BuiltinType.BOOLEAN:
        fits = isinstance(value, bool)
    else:
        fits = kind == BuiltinType.STRING and isinstance(value, str)
    if not fits or field.range is None:
        return fits
    return bool(field.range[0] <= float(value) <= field.range[1])
