"""The skills that `fleet.yaml` gives to the robots behind a bridge, for its driver. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Generic, TypeVar

from ua_fleet.bridge.driver import Skill, SkillTarget
from ua_fleet.config.base import Model
from ua_fleet.config.schema import FleetConfig, SkillConfig
from ua_fleet.fleet.skills import ArgumentModel, SkillLimits, argument_problem
from ua_fleet.pubsub.metadata import PropertyValue, make_field
from ua_fleet.topics import Topic
from ua_fleet.values import QualifiedName
from ua_fleet.wire.messages import FieldMetaData

__all__ = ["TARGET_ID", "ConfiguredSkill", "configured_skills"]

TARGET_ID: Final = 1
"""ActionTargetId: a skill in `fleet.yaml` belongs to one robot and has an id of its own."""

Via = TypeVar("Via", bound=Model)


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
    space, namespace = config.bridges[bridge_name].space, config.fleet.namespace_index
    return tuple(
        [
            ConfiguredSkill(
                robot_name,
                name,
                Topic(space, namespace, skill.id),
                Topic(space, namespace, robot.skill_status_id),
                skill,
                mapping.model_validate(skill.via) if skill.via else None,
            )
            for robot_name, robot in config.robots.items()
            if robot.bridge == bridge_name and robot.skill_status_id is not None
            for name, skill in robot.skills.items()
            if skill.id is not None
        ]
    )
