"""The data and the skills that `fleet.yaml` gives to the robots behind a bridge, for its driver. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, Generic, TypeVar

from ua_fleet.bridge.driver import Skill, SkillTarget
from ua_fleet.config.base import Model, ScalarType
from ua_fleet.config.schema import DataMapping, DataSetConfig, FleetConfig, SkillConfig
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.fleet.skills import ArgumentModel, SkillLimits, argument_problem
from ua_fleet.pubsub.metadata import PropertyValue, make_field
from ua_fleet.topics import SERVER_SPACE, Topic
from ua_fleet.values import QualifiedName
from ua_fleet.wire.messages import FieldMetaData

__all__ = [
    "TARGET_ID",
    "ConfiguredData",
    "ConfiguredSkill",
    "configured_faults",
    "configured_sinks",
    "configured_skills",
    "configured_sources",
    "every_data_set",
    "field_order",
]

TARGET_ID: Final = 1
"""ActionTargetId: a skill in `fleet.yaml` belongs to one robot and has an id of its own."""

Via = TypeVar("Via", bound=Model)
Side = TypeVar("Side", bound=DataMapping)


@dataclass(frozen=True)
class ConfiguredData(Generic[Side]):
    """One DataSet of a robot that a bridge reads or writes; `Side` is the model of its `source` or `sink`."""

    robot: str
    name: str
    topic: Topic
    config: DataSetConfig
    side: Side

    @property
    def label(self) -> str:
        """How it is named in a line for people."""
        return f"{self.robot}.{self.name}"

    @property
    def is_aging(self) -> bool:
        """Whether each reading counts, also one that brings the same values."""
        return self.config.max_age_s is not None

    @cached_property
    def types(self) -> Mapping[str, ScalarType]:
        """Its fields by the names that templates and patterns use: a single one is `value`."""
        return self.config.field_types()

    @cached_property
    def order(self) -> FieldOrder:
        """Puts the values of its messages into the order of `types`, whatever order their sender has."""
        return field_order(self.robot, self.name, self.config)

    @cached_property
    def fields(self) -> tuple[FieldMetaData, ...]:
        """Its fields as they are announced; a single one has the name of the data."""
        fields = self.config.all_fields().items()
        return tuple([make_field(name or self.name, each.type.builtin, array=each.array) for name, each in fields])


def field_order(robot: str, name: str, config: DataSetConfig) -> FieldOrder:
    """Puts the values of a DataSet's messages into the order of `config.field_types()`."""
    fields = config.all_fields().items()
    return FieldOrder(f"{robot}.{name}", [(field or name, each.path) for field, each in fields])


@dataclass(frozen=True)
class ConfiguredSkill(Generic[Via]):
    """One skill of a robot behind a bridge; `Via` is the bridge's model of how the robot does it."""

    robot: str
    name: str
    topic: Topic
    """Of the Action: (own space, namespace, id)."""
    status: Topic
    """The robot's SkillStatus."""
    config: SkillConfig
    via: Via | None
    """None: `fleet.yaml` does not say it."""

    @property
    def label(self) -> str:
        """How the skill is named in a line for people."""
        return f"{self.robot}.{self.name}"

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments, in the order of an execution's values."""
        return tuple(self.config.arguments)

    @property
    def limits(self) -> SkillLimits:
        """What the robot takes at most."""
        return self.config.limits.model()

    def offer(self) -> Skill:
        """The skill as the bridge announces it."""
        request, response = self.config.arguments, self.config.results
        return Skill(
            self.topic,
            self.name,
            (SkillTarget(TARGET_ID, self.robot, self.status),),
            tuple([_field(argument.model(name)) for name, argument in request.items()]),
            tuple([_field(result.model(name)) for name, result in response.items()]),
            is_immediate=self.config.immediate,
            limits=self.limits,
            problem=partial(_problem, tuple([argument.model(name) for name, argument in request.items()])),
        )


def _field(argument: ArgumentModel) -> FieldMetaData:
    """A field of the ActionMetaData, with what a requestor has to know of its values."""
    properties: dict[str, PropertyValue] = {}
    if argument.unit is not None:
        properties["Unit"] = argument.unit
    if argument.range is not None:
        properties["Range"] = argument.range
    field = make_field(argument.name, argument.type, properties=properties)
    if argument.typed_default is None:
        return field
    default = QualifiedName(0, "Default"), argument.type, argument.typed_default
    return field._replace(properties=(*field.properties, default))


def _problem(arguments: tuple[ArgumentModel, ...], values: tuple[Any, ...]) -> str | None:
    """Everything that is wrong with the values of a call."""
    problems = [argument_problem(argument, value) for argument, value in zip(arguments, values, strict=True)]
    return "; ".join([problem for problem in problems if problem is not None]) or None


def configured_skills(config: FleetConfig, bridge_name: str, mapping: type[Via]) -> tuple[ConfiguredSkill[Via], ...]:
    """The skills of the robots behind a bridge. A skill, or a robot, that has no id yet is left out."""
    space = config.bridges[bridge_name].space
    return tuple(
        [
            ConfiguredSkill(
                robot_name,
                name,
                Topic(space, robot.namespace, skill.id),
                Topic(space, robot.namespace, robot.skill_status_id),
                skill,
                mapping.model_validate(skill.via) if skill.via else None,
            )
            for robot_name, robot in config.robots.items()
            if robot.bridge == bridge_name and robot.skill_status_id is not None
            for name, skill in robot.skills.items()
            if skill.id is not None
        ]
    )


def every_data_set(config: FleetConfig) -> Iterator[tuple[str, str, Topic, DataSetConfig]]:
    """The data of all robots: robot, name, topic and what `fleet.yaml` says. What has no id yet is left out."""
    for robot_name, robot in config.robots.items():
        for name, data in robot.data.items():
            if data.id is not None:
                space = SERVER_SPACE if data.origin == "server" else config.space_of(robot_name)
                yield robot_name, name, Topic(space, robot.namespace, data.id), data


def configured_sources(
    config: FleetConfig, bridge_name: str, mapping: type[Side], unmapped: Side | None = None
) -> tuple[ConfiguredData[Side], ...]:
    """The data that a bridge reads from its robots.

    Args:
        config: the fleet.
        bridge_name: the bridge.
        mapping: its model of `source`.
        unmapped: what data without `source` has; None leaves it out.
    """
    found: list[ConfiguredData[Side]] = []
    for robot, name, topic, data in every_data_set(config):
        source = data.source or unmapped
        if data.origin == "robot" and config.robots[robot].bridge == bridge_name and isinstance(source, mapping):
            found.append(ConfiguredData(robot, name, topic, data, source))
    return tuple(found)


def configured_sinks(
    config: FleetConfig,
    bridge_name: str,
    mapping: type[Side],
    unmapped: Side | None = None,
    mirrors: Mapping[str, DataMapping] | None = None,
) -> tuple[ConfiguredData[Side], ...]:
    """The data of clients that a bridge writes to its robots, and that of others' robots in `mirrors`, by `robot.data`.

    The arguments are those of `configured_sources`.
    """
    found: list[ConfiguredData[Side]] = []
    for robot, name, topic, data in every_data_set(config):
        if config.robots[robot].bridge == bridge_name:
            sink = (data.sink or unmapped) if data.origin == "server" else None
        else:
            sink = (mirrors or {}).get(f"{robot}.{name}")
        if isinstance(sink, mapping):
            found.append(ConfiguredData(robot, name, topic, data, sink))
    return tuple(found)


def configured_faults(config: FleetConfig, bridge_name: str) -> dict[str, Topic]:
    """Where the robots behind a bridge say what is wrong with them, by robot; those that have an id for it."""
    space = config.bridges[bridge_name].space
    return {
        name: Topic(space, robot.namespace, robot.fault_id)
        for name, robot in config.robots.items()
        if robot.bridge == bridge_name and robot.fault_id is not None
    }
