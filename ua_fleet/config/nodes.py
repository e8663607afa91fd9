"""The nodes of a fleet from its `fleet.yaml`: which DataSets there are, with which ids and types."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ua_fleet.config.schema import (
    BridgeConfig,
    DataSetConfig,
    FleetConfig,
    RobotConfig,
    ScalarType,
    SkillConfig,
    value_name,
)
from ua_fleet.config.source_schema import PublishedSourceConfig
from ua_fleet.config.teleoperation import teleoperation_model
from ua_fleet.counters import OF_BRIDGES
from ua_fleet.errors import ConfigError
from ua_fleet.fleet.model import (
    BRIDGE_FIELDS,
    BridgeModel,
    DataSetModel,
    FieldModel,
    FleetModel,
    RobotModel,
    drop_field,
)
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.pubsub.layout import PLAIN, WriterSettings
from ua_fleet.pubsub.mapped import MappedSource, MappedSources, publisher_key
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.skill.status import SKILL_STATUS_FIELDS
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import ARRAY, BuiltinType, NodeId
from ua_fleet.wire.messages import ConfigurationVersion, DataSetMetaData, FieldEncoding

__all__ = [
    "data_topics",
    "events_topic",
    "fleet_model",
    "mapped_sources",
    "max_ages_of",
    "robot_model",
    "stated_metadata",
    "writer_settings",
]


def fleet_model(config: FleetConfig) -> FleetModel:
    """The model of a configuration that `load` has checked; raises ConfigError for a data source without an id."""
    ns = config.fleet.namespace_index
    bridges = tuple(
        _bridge(ns, name, bridge, [robot for robot in config.robots.values() if robot.bridge == name])
        for name, bridge in config.bridges.items()
    )
    robots = tuple(
        robot_model(name, robot, config.space_of(name), config.bridges[robot.bridge].status_id)
        for name, robot in config.robots.items()
    )
    return FleetModel(config.fleet.name, ns, robots, bridges, config.fleet.namespace_indices)


def max_ages_of(config: FleetConfig) -> dict[Topic, float]:
    """The maximum ages in seconds that are configured, by source."""
    return {
        Topic.checked(config.space_of(name), robot.namespace, data.id): data.max_age_s
        for name, robot in config.robots.items()
        for data in robot.data.values()
        if data.id is not None and data.max_age_s is not None
    }


def writer_settings(config: FleetConfig) -> dict[Topic, WriterSettings]:
    """How the DataSetWriters of data send that do not send key frames of Variants, by source."""
    found: dict[Topic, WriterSettings] = {}
    for name, robot in config.robots.items():
        for data in robot.data.values():
            encoding = FieldEncoding.RAW_DATA if data.encoding == "raw_data" else FieldEncoding.VARIANT
            settings = WriterSettings(encoding, data.key_frame_count)
            if data.id is not None and settings != PLAIN:
                space = SERVER_SPACE if data.origin == "server" else config.space_of(name)
                found[Topic(space, robot.namespace, data.id)] = settings
    if (events := events_topic(config)) is not None:
        found[events] = WriterSettings(are_events=True)
    return found


def events_topic(config: FleetConfig) -> Topic | None:
    """The DataSet of the events of runs; None where they are not published."""
    events_id = config.scenarios.events_id
    return None if events_id is None else Topic(SERVER_SPACE, config.fleet.namespace_index, events_id)


def mapped_sources(config: FleetConfig) -> MappedSources:
    """The DataSetWriters that `sources` names, as the data of the fleet's robots."""
    return MappedSources(
        MappedSource(
            publisher_key(source.type_code, source.publisher_id),
            source.writer_group_id,
            source.data_set_writer_id,
            Topic.checked(config.space_of(source.robot), config.robots[source.robot].namespace, data_id),
            _stated(name, source),
        )
        for name, source in config.sources.items()
        if (data_id := config.robots[source.robot].data[source.data].id) is not None
    )


def data_topics(config: FleetConfig) -> frozenset[Topic]:
    """The sources that `fleet.yaml` names, so that their fields are known."""
    return frozenset(
        Topic(SERVER_SPACE if data.origin == "server" else config.space_of(name), robot.namespace, data.id)
        for name, robot in config.robots.items()
        for data in robot.data.values()
        if data.id is not None
    )


def stated_metadata(config: FleetConfig) -> dict[tuple[str, int], DataSetMetaData]:
    """The fields that `sources` states of DataSetWriters, by their PublisherId as text and DataSetWriterId."""
    return {
        (str(source.publisher_id), source.data_set_writer_id): metadata
        for name, source in config.sources.items()
        if (metadata := _stated(name, source)) is not None
    }


def _stated(name: str, source: PublishedSourceConfig) -> DataSetMetaData | None:
    fields = tuple([make_field(field, one.type.builtin, array=one.array) for field, one in source.fields.items()])
    return DataSetMetaData(name, fields, ConfigurationVersion(0, 0)) if fields else None


def _bridge(ns: int, name: str, config: BridgeConfig, robots: Sequence[RobotConfig]) -> BridgeModel:
    status = None
    if config.status_id is not None:
        topic = Topic.checked(config.space, ns, config.status_id)
        names = [*BRIDGE_FIELDS, *((drop_field(drop.value), BuiltinType.UINT64) for drop in OF_BRIDGES)]
        fields = tuple(FieldModel(NodeId(ns, f"{topic.id}.{field}"), field, int(kind)) for field, kind in names)
        status = DataSetModel(topic, name, fields, config.description, is_single=False)
    return BridgeModel(name, config.kind, config.space, config.description, status, ns, config.reads_on_demand(robots))


def robot_model(name: str, config: RobotConfig, space: int, bridge_status: int | None = None) -> RobotModel:
    """The model of a robot whose configuration was checked; raises ConfigError for a data source without an id.

    `bridge_status` is the `status_id` of its bridge, for a robot that is driven by hand.
    """
    ns = config.namespace
    data_sets: list[DataSetModel] = []
    for browse_name, data_set in config.data.items():
        if data_set.id is None:
            raise ConfigError(
                "the data source has no id",
                key=f"robots.{name}.data.{browse_name}.id",
                suggestion="run: ua-fleet config assign-ids",
            )
        origin = SERVER_SPACE if data_set.origin == "server" else space
        takes_setpoints = config.teleoperation is not None and config.teleoperation.data == browse_name
        address = Topic.checked(origin, ns, data_set.id)
        data_sets.append(_data_set(address, browse_name, data_set, for_clients=not takes_setpoints))
    skills = tuple(_skill(name, skill_name, skill) for skill_name, skill in config.skills.items())
    status = config.skill_status_id
    if skills and status is None:
        raise ConfigError(
            "a robot with skills needs an id for their status",
            key=f"robots.{name}.skill_status_id",
            suggestion="run: ua-fleet config assign-ids",
        )
    topic = None if status is None else Topic.checked(space, ns, status)
    return RobotModel(
        name,
        config.bridge,
        config.description,
        config.capacities,
        tuple(data_sets),
        ns,
        skills,
        topic,
        () if topic is None else _skill_status_fields(topic),
        None if config.fault_id is None else _fault(Topic.checked(space, ns, config.fault_id)),
        mounted_on=config.mounted_on or "",
        card=_card(config),
        teleoperation=teleoperation_model(name, config, space, bridge_status),
    )


def _card(config: RobotConfig) -> tuple[NodeId, ...]:
    nodes = {
        value_name(data, field): NodeId(config.namespace, f"{one.id}.{field}" if field else one.id or 0)
        for data, one in config.data.items()
        for field in one.all_fields()
    }
    return tuple(nodes[name] for name in config.card)


def _fault(topic: Topic) -> DataSetModel:
    text = "What the robot says of its own fault; empty while it has none."
    field = FieldModel(NodeId(topic.ns, topic.id), "Fault", int(BuiltinType.STRING), can_wait=False)
    return DataSetModel(topic, "Fault", (field,), text)


def _skill_status_fields(topic: Topic) -> tuple[FieldModel, ...]:
    return tuple(
        FieldModel(NodeId(topic.ns, f"{topic.id}.{field.name}"), field.name, field.builtin_type | ARRAY, can_wait=False)
        for field in SKILL_STATUS_FIELDS
    )


def _skill(robot: str, name: str, config: SkillConfig) -> SkillModel:
    if config.id is None:
        raise ConfigError(
            "the skill has no id", key=f"robots.{robot}.skills.{name}.id", suggestion="run: ua-fleet config assign-ids"
        )
    return SkillModel(
        config.id,
        name,
        config.needs,
        tuple(argument.model(argument_name) for argument_name, argument in config.arguments.items()),
        tuple(result.model(result_name) for result_name, result in config.results.items()),
        config.timeout_s,
        config.immediate,
        config.limits.model(),
        config.description,
    )


def _data_set(topic: Topic, name: str, config: DataSetConfig, *, for_clients: bool) -> DataSetModel:
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
    return DataSetModel(
        topic,
        name,
        fields,
        config.description,
        is_single,
        None if config.sink is None else config.sink.message_type,
        for_clients,
        gives=config.gives,
        max_age_s=config.max_age_s,
    )


def _initial(value: Any, wanted: ScalarType) -> Any:
    """YAML writes 0 where a Double is meant."""
    is_float = wanted in (ScalarType.FLOAT, ScalarType.DOUBLE)
    return float(value) if is_float and isinstance(value, int) and not isinstance(value, bool) else value
