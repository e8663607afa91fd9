"""The schema of `fleet.yaml`, version 1.

Every key has a docstring or a description here; unknown keys are errors. `load.py` reads the file, finds the line of
each problem and checks what one model alone cannot see (ids used twice, a robot on a bridge that does not exist).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Annotated, ClassVar, Final, Literal, NamedTuple

from pydantic import BaseModel, Field, SerializeAsAny, field_validator, model_validator

from ua_fleet.config.alarm_schema import LimitsConfig, NormalConfig
from ua_fleet.config.audit_schema import AuditConfig
from ua_fleet.config.base import RANGED, DataSetId, FieldPath, Model, Name, Port, ScalarType
from ua_fleet.config.field_schema import OF_FIELDS, FieldConfig
from ua_fleet.config.history_schema import HistoryConfig, ValueHistoryConfig
from ua_fleet.config.modbus_schema import ModbusServerConfig
from ua_fleet.config.namespace_schema import UnifiedNamespaceConfig
from ua_fleet.config.pubsub_schema import KeysConfig, PubSubConfig, PubSubSecurity
from ua_fleet.config.relay_schema import RelayConfig
from ua_fleet.config.resilience_schema import ResilienceConfig
from ua_fleet.config.shapes import VENDOR_SPACE, all_of, exactly_one, given, implies, limited_to, none_of
from ua_fleet.config.skill_schema import SkillConfig
from ua_fleet.config.source_schema import PublishedSourceConfig, PublisherIdTypeName, wire_publisher_id
from ua_fleet.config.teleoperation_schema import TeleoperationConfig
from ua_fleet.document import KeyPath
from ua_fleet.errors import TopicInvalid
from ua_fleet.fleet.model import FIRST_NAMESPACE, FLEET_NAMESPACE, UnknownSources
from ua_fleet.topics import FIRST_VENDOR_SPACE, SERVER_SPACE, check_space

__all__ = [
    "FIELD_NAME",
    "MESSAGE_TYPE",
    "TOPIC_NAME",
    "BridgeConfig",
    "DataMapping",
    "DataSetConfig",
    "FieldConfig",
    "FleetConfig",
    "FleetInfo",
    "KeysConfig",
    "MachineFinding",
    "MonitoringConfig",
    "PubSubConfig",
    "PubSubSecurity",
    "RelayConfig",
    "ResilienceConfig",
    "RobotConfig",
    "ScalarType",
    "ScenariosConfig",
    "ServerConfig",
    "SkillConfig",
    "TeleoperationConfig",
    "UnifiedNamespaceConfig",
    "UnknownSources",
    "VendorBridgeConfig",
    "value_name",
]


class DataMapping(Model, frozen=True):
    """What `source` and `sink` of a data source say. Each kind of bridge derives its own from this one."""

    @property
    def own_topic(self) -> str | None:
        """The full name of the robot's own topic that it stands for; None in a space without topics."""
        return None

    @property
    def message_type(self) -> str | None:
        """The type of that topic's messages, `pkg/Name`."""
        return None


MESSAGE_TYPE: Final = r"^[a-z][a-z0-9_]*/(msg/)?[A-Z][A-Za-z0-9]*$"
TOPIC_NAME: Final = r"^/?[A-Za-z_][A-Za-z0-9_/]*$"
FIELD_NAME: Final = r"^[A-Za-z][A-Za-z0-9_.]{0,127}$"
ValueName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]{0,191}$", examples=["battery"])]
MessageTypeName = Annotated[str, Field(pattern=MESSAGE_TYPE, examples=["sensor_msgs/BatteryState"])]


class DataSetConfig(
    Model,
    frozen=True,
    json_schema_extra=all_of(
        exactly_one("type", "fields", empty=({},)),
        implies(
            given("fields", {}),
            none_of(*OF_FIELDS, empty=(False, "")),
        ),
        implies(given("range"), limited_to("type", *RANGED)),
        implies(given("gives", []), {"not": limited_to("origin", "server")}),
        implies(given("source"), {"not": limited_to("origin", "server")}),
        implies(given("sink"), limited_to("origin", "server")),
        implies(given("max_age_s"), {"not": limited_to("origin", "server")}),
    ),
):
    """One data source of a robot: a node with a numeric id, or an object with it and a variable for each field."""

    id: DataSetId | None = None
    """Needed in the end: numeric id in the fleet's namespace, an address. `ua-fleet config assign-ids`
    fills it in. Never use one again for something else."""
    origin: Literal["robot", "server"] = "robot"
    """`robot`: the data originates in the robot's space. `server`: clients write it, the robot receives it."""
    description: str = ""
    """Text for people, the description of the node."""
    type: ScalarType | None = None
    """Short form for a single field; use `fields` for several."""
    array: bool = False
    """Short form, as in a field."""
    unit: str | None = None
    """Short form, as in a field."""
    range: tuple[float, float] | None = None
    """Short form, as in a field."""
    path: FieldPath | None = None
    """Short form, as in a field; `data` if left out."""
    initial: bool | int | float | str | None = None
    """Short form, as in a field."""
    limits: LimitsConfig | None = None
    """Short form, as in a field."""
    normal: bool | NormalConfig | None = None
    """Short form, as in a field."""
    fields: dict[Annotated[str, Field(pattern=FIELD_NAME)], FieldConfig] = {}
    """Several fields: name to field."""
    source: SerializeAsAny[DataMapping] | None = None
    """What the data is read from, by the bridge's kind: a robot's own topic, registers. Without it the source is the
    topic `ua_<space>_<ns>_<id>`, where the kind has topics."""
    sink: SerializeAsAny[DataMapping] | None = None
    """What the data is also written to, by the bridge's kind."""
    ros_type: MessageTypeName | None = None
    """Message type as `pkg/Name` with which several `fields` reach the ROS spaces that they do not come from; its
    members have the names of the fields. Left out: a `std_msgs/String` with a JSON object."""
    max_age_s: float | None = Field(default=None, ge=0.1, le=1e7, allow_inf_nan=False)
    """For how long a value counts as one of now after it was read: sent by the robot, or read from it again, changed or
    not. Then it is Uncertain_NoCommunicationLastUsableValue until it is read again. Left out: a topic of ROS that comes
    with a period and is not latched has ten periods, at least 3 s; all else has no maximum age."""
    encoding: Literal["variant", "raw_data"] = "variant"
    """How fields travel in PubSub messages. `raw_data`: without their types, which the metadata tells. A message in
    which a field has no value goes as Variants all the same."""
    key_frame_count: int = Field(default=1, ge=1, le=0xFFFF)
    """KeyFrameCount: of so many PubSub messages at least one has all fields (a key frame), and so has one each
    `pubsub.repeat_interval_s`; the others have only what has changed (delta frames)."""
    gives: tuple[Name, ...] = ()
    """Capacities that the robot has only while this data source is there, e.g. `temperature` of a thermometer that may
    be pulled out. The robot that this one is `mounted_on` has them too."""
    history: ValueHistoryConfig | bool | None = None
    """What is kept of its values, where that differs from the robot's; `true` and `false`: whether it is."""

    @model_validator(mode="after")
    def _check(self) -> DataSetConfig:
        if self.max_age_s is not None and self.origin == "server":
            raise ValueError("max_age_s: data that clients write stays until it is written again; remove it")
        if self.gives and self.origin == "server":
            raise ValueError("gives: data that clients write gives no capacity; remove it")
        if self.fields and self.type is not None:
            raise ValueError("give either `type` (one field) or `fields` (several), not both")
        if not self.fields and self.type is None:
            raise ValueError("give `type` (one field) or `fields` (several)")
        if self.ros_type is not None and not self.fields:
            raise ValueError("ros_type: give `fields`; a single value has the type of std_msgs")
        if self.fields and (self.array or any(getattr(self, name) not in (None, "") for name in OF_FIELDS[1:])):
            raise ValueError("with `fields`, array, unit, range, path, initial, limits and normal belong to each field")
        if self.origin == "server" and any(each.has_alarm for each in self.all_fields().values()):
            raise ValueError("limits and normal: data that clients write has no alarms; use `range`, or remove them")
        self.all_fields()
        return self

    def all_fields(self) -> dict[str, FieldConfig]:
        """The fields by name; the single field of the short form has the empty name."""
        if self.fields:
            return self.fields
        assert self.type is not None
        single = FieldConfig(
            type=self.type,
            array=self.array,
            unit=self.unit,
            range=self.range,
            path=self.path,
            initial=self.initial,
            limits=self.limits,
            normal=self.normal,
        )
        return {"": single}

    def field_types(self) -> dict[str, ScalarType]:
        """The fields by the names that templates and patterns use: a single one is `value`."""
        return {name or "value": field.type for name, field in self.all_fields().items()}


def value_name(data: str, field: str) -> str:
    """A value by the names that people use: `battery` of a single field, `pose.x` of several."""
    return f"{data}.{field}" if field else data


class RobotConfig(Model, frozen=True):
    """One robot (or machine, or cell) of the fleet."""

    bridge: Name
    """The bridge in whose space the robot lives."""
    namespace: int = Field(default=FLEET_NAMESPACE, ge=FLEET_NAMESPACE, le=0xFFFF)
    """Namespace of the ids here, and number of the WriterGroup: 2, or the index of one in `fleet.namespaces`."""
    description: str = ""
    """Text for people, the description of the node."""
    capacities: tuple[Name, ...] = ()
    """What the robot can do in kind, e.g. `mobile`, `grab`."""
    mounted_on: Name | None = None
    """The robot that carries this one, e.g. the one whose computer devices are plugged into: it has what the data here
    gives."""
    data: dict[Name, DataSetConfig] = {}
    """The robot's data sources by browse name."""
    card: Annotated[tuple[ValueName, ...], Field(max_length=3)] = ()
    """Values that lists of robots show of this one, e.g. `[battery, pose.x]`: of `data`, with the field's name where
    there are several; no arrays or ByteStrings. Left out: how full its battery is, where its name says so."""
    skills: dict[Name, SkillConfig] = {}
    """What the robot does when it is asked."""
    skill_status_id: DataSetId | None = None
    """Needed for a robot with skills: numeric id of the DataSet with its last executions. `ua-fleet config assign-ids`
    fills it in."""
    fault_id: DataSetId | None = None
    """For a robot that announces its own faults: numeric id of that DataSet, a text that is empty while all is well."""
    teleoperation: TeleoperationConfig | None = None
    """How people drive it by hand; left out: nobody does."""
    history: ValueHistoryConfig | bool | None = None
    """What is kept of its values, where that differs from the fleet's; `true` and `false`: whether they are."""


class MachineFinding(NamedTuple):
    """What a look at this machine shows of a key of the file."""

    text: str
    suggestion: str = ""
    is_doubt: bool = False
    """Whether this machine cannot tell: that is no problem of the file."""


class BridgeConfig(Model, frozen=True):
    """What every bridge has. Each bridge package derives its own model from this one in its `config.py`.

    The package is found by `kind` through the entry point group `ua_fleet.bridges`, so that a new kind of bridge
    changes nothing here.
    """

    kind: str
    """Kind of the bridge: the name of its package in `ua_bridges`."""
    space: int
    """Id of the space that the bridge stands in."""
    status_id: DataSetId | None = None
    """Needed in the end: numeric id of the bridge's own status DataSet. `ua-fleet config assign-ids` fills it in."""
    description: str = ""
    """Text for people, the description of the node."""
    publisher_id: int | Annotated[str, Field(min_length=1, max_length=1024)] | None = None
    """PublisherId of its PubSub messages, for receivers that know it by another one. Left out: its space."""
    publisher_id_type: PublisherIdTypeName | None = None
    """Type of `publisher_id`. Left out: UInt16 for a number, String for a text."""
    state_dir: str | None = None
    """Folder for the bridge's certificate, key use and journal; `state/bridges/<name>` if left out. Relative to
    `fleet.yaml`."""
    connections: tuple[Name, ...] = ()
    """Names of the connections that the bridge is on, where `pubsub` is a list of them. Left out: the first one."""
    requestors: tuple[Annotated[int, Field(ge=0, le=65535)], ...] = (SERVER_SPACE,)
    """Spaces that may command this one by Actions; 0 is the server."""
    monitoring_port: Port | None = None
    """This bridge's port in place of `monitoring.port`."""

    skill_mapping: ClassVar[type[BaseModel] | None] = None
    """Model of `via` in a skill of a robot on such a bridge; None where bridges of this kind run no skills."""
    source_mapping: ClassVar[type[DataMapping] | None] = None
    """Model of `source` in the data of such a robot; None where bridges of this kind read nothing by configuration."""
    sink_mapping: ClassVar[type[DataMapping] | None] = None
    """Model of `sink` in the data of such a robot; None where bridges of this kind write nothing by configuration."""
    takes_setpoints: ClassVar[bool] = False
    """Whether such robots can be driven by hand: the driver has `write_setpoint`."""

    @model_validator(mode="after")
    def _check_publisher_id(self) -> BridgeConfig:
        if self.publisher_id is None and self.publisher_id_type is not None:
            raise ValueError("publisher_id_type: give `publisher_id` too")
        if self.publisher_id is not None:
            wire_publisher_id(self.publisher_id, self.publisher_id_type)
        return self

    @property
    def wire_id(self) -> tuple[int, int | str] | None:
        """Type and value of `publisher_id`, as messages have them."""
        return None if self.publisher_id is None else wire_publisher_id(self.publisher_id, self.publisher_id_type)

    @field_validator("space")
    @classmethod
    def _space(cls, space: int) -> int:
        if space == SERVER_SPACE:
            raise ValueError("space 0 is the server's own")
        try:
            return check_space(space)
        except TopicInvalid as error:
            raise ValueError(error.reason) from error

    def reads_on_demand(self, robots: Iterable[RobotConfig]) -> bool:
        """Whether it reads some data of its `robots` only while somebody follows it, which the server then tells."""
        return False

    def problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """What is wrong between this bridge and its robots, beyond what one model alone can see.

        Args:
            name: the bridge's own.
            robots: those on this bridge, by name, with their valid data and skills.

        Returns:
            For each problem the path of the key from the top of the file, the problem, and a suggestion or "".
        """
        return ()

    def findings_here(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, MachineFinding]]:
        """What a valid file has wrong by what is installed on this machine, such as message types; arguments as in
        `fleet_problems`.
        """
        return ()

    def fleet_problems(self, name: str, robots: Mapping[str, RobotConfig]) -> Iterable[tuple[KeyPath, str, str]]:
        """As `problems`, for a kind whose own keys name robots of other bridges: `robots` are those of the fleet."""
        return self.problems(name, {robot: config for robot, config in robots.items() if config.bridge == name})


class VendorBridgeConfig(BridgeConfig, frozen=True):
    """What every bridge has whose space is one of the vendor spaces: to a PLC, a controller, a computer's devices."""

    space: int = Field(json_schema_extra=VENDOR_SPACE)
    """Id of the bridge's own space, 256 to 65535."""

    @field_validator("space")
    @classmethod
    def _vendor_space(cls, space: int) -> int:
        if space < FIRST_VENDOR_SPACE:
            raise ValueError(f"a bridge of this kind has a vendor space of its own, {FIRST_VENDOR_SPACE} to 65535")
        return space


class ServerConfig(Model, frozen=True):
    """The OPC UA server."""

    host: str = "127.0.0.1"
    """Address to listen on; `0.0.0.0` for all of this machine's, `::` for all its IPv6 addresses."""
    port: int = Field(default=4840, ge=0, le=65535)
    """TCP port; 0 takes any free one."""
    path: Annotated[str, Field(pattern=r"^[A-Za-z0-9_/-]*$")] = "ua_fleet"
    """Path of the endpoint URL `opc.tcp://<host>:<port>/<path>`."""
    state_dir: str = "state"
    """Folder for users, certificates, keys and the audit log; relative to `fleet.yaml`."""
    connections: tuple[Name, ...] = ()
    """Names of the PubSub connections that the server is on, where `pubsub` is a list of them. Left out: all."""
    allow_none_security: bool = False
    """Also offer an endpoint without signature and encryption. Says so at every start."""
    allow_anonymous: bool = False
    """Let clients in without a user; they get the role observer. Says so at every start."""
    trust_all_clients: bool = False
    """Accept any client certificate. Otherwise each must be trusted by `ua-fleet cert trust`."""
    max_session_key_days: float = Field(default=30, ge=0, le=3650)
    """Longest life of a session key, by which clients do without the password; 0: there are none."""
    unknown_sources: UnknownSources = UnknownSources.QUARANTINE
    """`create`: read-only nodes under Discovered. `quarantine`: listed, but no values. `ignore`: counted only."""
    max_discovered_sources: int = Field(default=1000, ge=0)
    """Most sources that `create` and `quarantine` keep; the rest is counted. In all 20 times as many fields."""
    max_connections: int = Field(default=100, ge=1)
    """TCP connections of all clients together."""
    max_sessions: int = Field(default=50, ge=1)
    """Sessions of all clients together."""
    max_sessions_per_user: int = Field(default=10, ge=1)
    """Sessions of one user, or of one address where clients have no user."""
    reserved_sessions: int = Field(default=10, ge=0)
    """Of `max_sessions`, those that only engineers and bridges get; at most half of them."""
    max_subscriptions_per_session: int = Field(default=50, ge=1)
    """Subscriptions of one session."""
    max_monitored_items_per_subscription: int = Field(default=20_000, ge=1)
    """Monitored items of one subscription; one user, or an address without one, may have three times as many in all."""
    max_nodes_per_request: int = Field(default=10_000, ge=1)
    """Operations of one request, e.g. nodes that are read at once."""
    max_message_bytes: int = Field(default=4 * 1024 * 1024, ge=65_536)
    """Largest request of an authenticated client; before authentication at most 64 KiB are taken."""
    analog_rate_hz: float = Field(default=10.0, gt=0)
    """An analog value's node is written at most so often; the last value always arrives."""
    audit: AuditConfig = AuditConfig()
    """The audit log in `state_dir`."""
    monitoring_port: Port | None = None
    """The server's port in place of `monitoring.port`."""

    @field_validator("host")
    @classmethod
    def _host(cls, host: str) -> str:
        if not host or host != host.strip("[]"):
            raise ValueError("write a host, 0.0.0.0 for all addresses, or an IPv6 address without brackets")
        return host


class MonitoringConfig(Model, frozen=True):
    """Where each process answers `/healthz`, `/readyz` and `/metrics`; see docs/monitoring.md."""

    enabled: bool = True
    """`false`: no process listens, and `ua-fleet healthcheck` cannot ask."""
    host: str = "127.0.0.1"
    """Address to listen on. Nobody is asked who they are there: choose one that only those reach who may know it."""
    port: Port = 0
    """TCP port of every process, for processes on machines of their own; 0: any free one, which the process writes to
    `monitoring.json` in its `state_dir`."""
    names: tuple[Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")], ...] = ()
    """Names of this machine by which Prometheus may ask, besides addresses, `localhost` and the machine's own."""


class FleetInfo(Model, frozen=True):
    """The fleet as a whole."""

    name: Name = "Fleet"
    """Name of the fleet's object, `Objects/<name>`."""
    namespace_uri: Annotated[str, Field(min_length=3)] = "urn:ua-fleet:fleet"
    """URI of the namespace of all nodes of the fleet. Clients remember it: choose your own, and keep it."""
    namespace_index: Literal[2] = 2
    """Index of the fleet's namespace. Topics carry it, so the server refuses to start when its table disagrees."""
    namespaces: tuple[Annotated[str, Field(min_length=3)], ...] = ()
    """URIs of further namespaces, with the indices 4, 5 and so on: each has 65,535 ids for robots whose `namespace` it
    is."""
    places: dict[Annotated[str, Field(min_length=1)], tuple[float, float]] = {}
    """Places by name for maps, x and y in metres. Those that criteria of `resilience` measure to are shown too."""

    @property
    def namespace_indices(self) -> tuple[int, ...]:
        """The namespaces that data may have; between the fleet's and the others lies that of the types."""
        return (self.namespace_index, *range(FIRST_NAMESPACE, FIRST_NAMESPACE + len(self.namespaces)))


class ScenariosConfig(Model, frozen=True):
    """Scenarios that operators run."""

    folder: str = "scenarios"
    """Folder of the scenarios' files, `<name>.yaml` or `.json`; relative to `fleet.yaml`."""
    events_id: DataSetId | None = None
    """Numeric id of the DataSet in which the server publishes the events of runs, steps and decisions, one PubSub
    message each: `ua_0_2_<id>`. Left out: they are told to OPC UA clients alone."""
    most_runs: int = Field(default=16, ge=1)
    """Runs that may be under way at once."""
    kept_runs: int = Field(default=100, ge=0)
    """Runs that have ended and are still shown."""
    adopt_after_s: float = Field(default=60.0, gt=0)
    """A bridge that carries a run, and has not answered for so long, may be said to be off: another one goes on."""


class FleetConfig(Model, frozen=True):
    """`fleet.yaml`."""

    version: Literal[1]
    """Version of this format."""
    fleet: FleetInfo = FleetInfo()
    """The fleet as a whole."""
    server: ServerConfig = ServerConfig()
    """The OPC UA server."""
    pubsub: PubSubConfig
    """OPC UA PubSub between the server and the bridges: the keys of one connection, or a list of connections."""
    bridges: dict[Name, SerializeAsAny[BridgeConfig]] = {}
    """Bridges by name, each with the keys of its kind."""
    robots: dict[Name, RobotConfig] = {}
    """Robots by name."""
    resilience: ResilienceConfig = ResilienceConfig()
    """Which robot takes over when another robot fails."""
    scenarios: ScenariosConfig = ScenariosConfig()
    """Scenarios that operators run."""
    monitoring: MonitoringConfig = MonitoringConfig()
    """Health and metrics of every process."""
    history: HistoryConfig | None = None
    """The history of values; left out: none is kept."""
    sources: dict[Name, PublishedSourceConfig] = {}
    """Publishers that are no bridges of the fleet, as the data of its robots."""
    relays: dict[Name, RelayConfig] = {}
    """Processes that forward data between the PubSub connections."""
    modbus: ModbusServerConfig | None = None
    """The fleet as a Modbus device, for PLCs; left out: it is none."""
    unified_namespace: UnifiedNamespaceConfig | None = None
    """The values of robots as plain JSON on an MQTT broker; left out: they are not published so."""

    @field_validator("history", mode="before")
    @classmethod
    def _empty_history(cls, value: object) -> object:
        return {} if value is None else value  # the key alone turns it on, as a section with comments alone does

    @property
    def connections(self) -> tuple[PubSubConfig, ...]:
        """The PubSub connections; `pubsub` is the first one, and has what holds for all."""
        return (self.pubsub,)

    @property
    def is_secured(self) -> bool:
        """Whether any connection needs keys."""
        return any(connection.is_secured for connection in self.connections)

    def namespace_of(self, robot_name: str) -> int:
        """The namespace of a robot's ids."""
        return self.robots[robot_name].namespace

    def space_of(self, robot_name: str) -> int:
        """The space in which a robot lives."""
        return self.bridges[self.robots[robot_name].bridge].space

    def state_dir_of(self, bridge_name: str) -> str:
        """The folder of what a bridge or a relay has to remember, relative to `fleet.yaml`."""
        if (relay := self.relays.get(bridge_name)) is not None:
            return relay.state_dir or f"state/relays/{bridge_name}"
        return self.bridges[bridge_name].state_dir or f"state/bridges/{bridge_name}"
