"""The nodes that stand for a fleet; `ua_fleet.config.nodes` makes them from `fleet.yaml`.

A node's key is its NodeId. The numeric id belongs to the DataSet: with one field the Variable has it, with several an
Object has it and its field Variables have the string ids `<id>.<field>`. Everything else has a stable string id.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, Final

from ua_fleet.fleet.skills import SkillModel
from ua_fleet.teleoperation.model import TeleoperationModel
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import BuiltinType, NodeId

__all__ = [
    "BRIDGE_FIELDS",
    "FIRST_NAMESPACE",
    "FLEET_NAMESPACE",
    "GROUP_SIZE",
    "MAX_AGE_PREFIX",
    "TRAFFIC_FIELDS",
    "BridgeModel",
    "DataSetModel",
    "FieldModel",
    "FleetModel",
    "RobotModel",
    "RobotOrigin",
    "RobotState",
    "UnknownSources",
    "drop_field",
]

FLEET_NAMESPACE: Final = 2
"""Index of the namespace of all nodes but those whose ids are of another one."""
FIRST_NAMESPACE: Final = 4
"""Index of the first of `fleet.namespaces`; the types have 3."""
GROUP_SIZE: Final = 100
"""Most children of one folder: asyncua and clients alike go through all of them for each."""
MAX_AGE_PREFIX: Final = "MaxAge."
"""What the id of the Property MaxAge begins with; the number of its data source follows."""

TRAFFIC_FIELDS: Final = ("MessagesIn", "MessagesOut", "Gaps", "Looped")
"""Variables of TrafficType beside its drops."""
BRIDGE_FIELDS: Final[tuple[tuple[str, BuiltinType], ...]] = (
    ("Connected", BuiltinType.BOOLEAN),
    ("Detail", BuiltinType.STRING),
    ("FromSpace", BuiltinType.UINT64),
    ("ToSpace", BuiltinType.UINT64),
    ("LagP99", BuiltinType.DOUBLE),
    ("OldestWaiting", BuiltinType.DOUBLE),
    *((name, BuiltinType.UINT64) for name in TRAFFIC_FIELDS),
)
"""Fields of a bridge's status DataSet that BridgeType shows, beside its drops."""


class UnknownSources(StrEnum):
    """What the server does with a source that `fleet.yaml` does not name."""

    CREATE = "create"
    QUARANTINE = "quarantine"
    IGNORE = "ignore"


class RobotState(IntEnum):
    """RobotStateEnumeration of the UaFleet nodeset."""

    OFFLINE = 0
    IDLE = 1
    BUSY = 2
    FAULTED = 3


class RobotOrigin(StrEnum):
    """How a robot came to the fleet."""

    FILE = "fleet.yaml"
    REGISTERED = "registered"
    """By a client: RegisterRobot."""
    ANNOUNCED = "announced"
    """By its bridge, on PubSub."""


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
    can_wait: bool = True
    """Whether of several values in quick succession the last one will do, where it is a number."""


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
    for_clients: bool = True
    """Whether clients write it where it originates in the server; else the server itself says it."""
    gives: tuple[str, ...] = ()
    """Capacities that its robot has only while it is there."""
    max_age_s: float | None = None
    """The maximum age that is configured; its publisher may know another one."""

    @property
    def max_age_key(self) -> NodeId:
        """The Property MaxAge."""
        return NodeId(self.topic.ns, f"{MAX_AGE_PREFIX}{self.topic.id}")

    @property
    def key(self) -> NodeId:
        """The node that has the DataSet's numeric id."""
        return NodeId(self.topic.ns, self.topic.id)

    @property
    def writable(self) -> bool:
        """Whether clients may write it: only what originates in the server."""
        return self.topic.space == SERVER_SPACE and self.for_clients


@dataclass(frozen=True, slots=True)
class RobotModel:
    """One robot."""

    name: str
    bridge: str
    description: str
    capacities: tuple[str, ...]
    data_sets: tuple[DataSetModel, ...]
    ns: int
    """Namespace of the ids of its data and skills; its own object is in the fleet's."""
    skills: tuple[SkillModel, ...] = ()
    skill_status: Topic | None = None
    """DataSet with the robot's last executions; None without skills."""
    skill_status_fields: tuple[FieldModel, ...] = ()
    fault: DataSetModel | None = None
    """What the robot says of its own fault, a text that is empty while it has none; None where it says nothing."""
    origin: RobotOrigin = RobotOrigin.FILE
    mounted_on: str = ""
    """The robot that carries this one, and has what the data here gives."""
    teleoperation: TeleoperationModel | None = None
    """How it is driven by hand; None where it is not."""
    card: tuple[NodeId, ...] = ()
    """The Variables that lists of robots show of it."""

    @property
    def key(self) -> NodeId:
        """The robot's object."""
        return NodeId(FLEET_NAMESPACE, f"Robots.{self.name}")

    def part(self, name: str) -> NodeId:
        """A node of the robot that is no DataSet, e.g. State."""
        return NodeId(FLEET_NAMESPACE, f"Robots.{self.name}.{name}")

    @property
    def skill_status_data(self) -> DataSetModel | None:
        """`skill_status` with its fields."""
        if self.skill_status is None:
            return None
        text = "The last executions of the robot's skills, the oldest first."
        fields = self.skill_status_fields
        return DataSetModel(self.skill_status, "SkillStatus", fields, text, is_single=False, for_clients=False)

    @property
    def teleoperation_data(self) -> DataSetModel | None:
        """What its bridge says of how it is driven by hand. It has no fields here: see `server.teleoperation`."""
        if self.teleoperation is None:
            return None
        return DataSetModel(self.teleoperation.status, "Teleoperation", (), is_single=False, for_clients=False)

    def actions(self) -> Iterator[Topic]:
        """The Actions of its skills."""
        if self.skill_status is not None:
            for skill in self.skills:
                yield Topic(self.skill_status.space, self.ns, skill.id)

    def all_actions(self) -> Iterator[Topic]:
        """The same with those by which it is driven by hand."""
        yield from self.actions()
        if self.teleoperation is not None:
            yield from self.teleoperation.actions

    def all_data_sets(self) -> Iterator[DataSetModel]:
        """Its data, and what it says of its skills and faults, and of who drives it."""
        yield from self.data_sets
        if (status := self.skill_status_data) is not None:
            yield status
        if (driven := self.teleoperation_data) is not None:
            yield driven
        if self.fault is not None:
            yield self.fault


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
    reads_on_demand: bool = False
    """Whether it has to be told which of its data somebody follows."""

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
    namespaces: tuple[int, ...] = (FLEET_NAMESPACE,)
    """Those that data may have."""

    def data_sets(self) -> Iterator[DataSetModel]:
        """All configured DataSets, those of skills' and bridges' status included."""
        for robot in self.robots:
            yield from robot.all_data_sets()
        for bridge in self.bridges:
            if bridge.status is not None:
                yield bridge.status

    def traffic(self, name: str) -> NodeId:
        """A node of the server's own TrafficType object."""
        return NodeId(self.ns, f"Fleet.Traffic.{name}")
