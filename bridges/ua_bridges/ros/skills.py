"""How a ROS robot does a skill: `via` of a skill in `fleet.yaml`, for the bridges of ROS 1 and ROS 2 alike. Pure.

    topic      publish a message; another topic says when it is done or has failed
    service    call a service, whose response is the end
    action     give a goal to an action server (ROS 1: actionlib)
    (none)     the robot's own program offers the skill, see `skill_json.py`

Arguments go to the member of their own name unless `fields` names another one; results come from the member of their
own name unless `results` does. Conditions are those of scenarios (`ua_fleet.scenario.expression`) over the members of a
message, and `arguments.<name>` over what was asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Final

from pydantic import AfterValidator, Field, ValidationError, model_validator

from ua_bridges.ros.topic_mapping import QosConfig
from ua_fleet.bridge.configured import ConfiguredSkill, configured_skills
from ua_fleet.bridge.driver import Skill
from ua_fleet.config.base import FieldPath, Model
from ua_fleet.config.schema import FleetConfig, RobotConfig, SkillConfig
from ua_fleet.config.shapes import exactly_one
from ua_fleet.document import KeyPath
from ua_fleet.errors import ScenarioError
from ua_fleet.fleet.skills import SkillLimits
from ua_fleet.names import closest, listed
from ua_fleet.scenario.expression import parse_expression
from ua_fleet.topics import SERVER_SPACE, Topic

__all__ = [
    "ARGUMENTS",
    "ActionSkill",
    "Constant",
    "RosSkillMapping",
    "ServiceSkill",
    "SkillSpec",
    "StatusTopic",
    "TopicSkill",
    "skill_problems",
    "skill_specs",
]

ARGUMENTS: Final = "arguments."
"""What begins so in a condition is an argument of the skill."""


def _expression(text: str) -> str:
    try:
        parse_expression(text)
    except ScenarioError as error:
        raise ValueError(str(error)) from error
    return text


Expression = Annotated[str, AfterValidator(_expression)]
"""A condition, or a number, over the members of a message, e.g. `state == "parked"` or `percent / 100`."""
Scalar = bool | int | float | str
Constant = Scalar | tuple[Scalar, ...]
RosName = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_/]*$", examples=["/dock"])]


def _type_pattern(folder: str) -> str:
    return rf"^[a-z][a-z0-9_]*/({folder}/)?[A-Z][A-Za-z0-9_]*$"


MessageType = Annotated[str, Field(pattern=_type_pattern("msg"), examples=["geometry_msgs/Twist"])]


class _Request(Model, frozen=True):
    """What goes to the robot."""

    fields: dict[str, FieldPath] = Field(default={})
    """Argument to the member that it goes to, e.g. `speed: linear.x`; left out: the member of the argument's name."""
    constants: dict[FieldPath, Constant] = Field(default={})
    """Members that always have the same value."""


class _Response(Model, frozen=True):
    """What comes back from the robot."""

    results: dict[str, FieldPath] = Field(default={})
    """Result to the member that it is read from; left out: the member of the result's name."""
    message: FieldPath | None = None
    """Member with a text for people, e.g. why it failed."""


class StatusTopic(_Response, frozen=True):
    """The topic on which a robot says how it gets on with what was published."""

    topic: RosName
    """Name of the topic."""
    type: MessageType
    """Message type as `pkg/Name`."""
    qos: QosConfig = QosConfig()
    """ROS 2 only: quality of service."""
    running: Expression | None = None
    """Holds while the robot is at it. With it `done` and `failed` count only after it has held once: for a topic that
    still tells the end of the last time when the robot begins."""
    done: Expression
    """Holds when it is done."""
    failed: Expression | None = None
    """Holds when it has failed."""
    halted: Expression | None = None
    """With `halt`: holds when the robot stands after it was told to stop. `done`, `failed`, and `running` that holds no
    more tell it too; where none does within 5 s, nobody knows whether it stands: Unknown."""
    progress: Expression | None = None
    """How far it is, 0 to 1."""


class TopicSkill(_Request, frozen=True):
    """Publish a message, then wait for a condition on a topic."""

    topic: RosName
    """Name of the topic that is published to."""
    type: MessageType
    """Message type as `pkg/Name`."""
    qos: QosConfig = QosConfig()
    """ROS 2 only: quality of service."""
    status: StatusTopic | None = None
    """Where the robot says how it gets on. Left out: it is done when it is published."""
    halt: dict[FieldPath, Constant] | None = None
    """Members of the message that stops the robot; the others have their defaults. Left out: it cannot be stopped."""


class ServiceSkill(_Request, _Response, frozen=True):
    """Call a service; its response is the end."""

    name: RosName
    """Name of the service."""
    type: Annotated[str, Field(pattern=_type_pattern("srv"), examples=["std_srvs/Trigger"])]
    """Service type as `pkg/Name`."""
    success: Expression | None = None
    """Over the response: whether it is done. Left out: any response means done."""


class ActionSkill(_Request, _Response, frozen=True):
    """Give a goal to an action server."""

    name: RosName
    """Name of the action."""
    type: Annotated[str, Field(pattern=_type_pattern("action"), examples=["control_msgs/FollowJointTrajectory"])]
    """Action type as `pkg/Name`."""
    success: Expression | None = None
    """Over the result of a goal that succeeded: whether it is done. Left out: it is."""
    progress: Expression | None = None
    """Over the feedback: how far it is, 0 to 1."""


class RosSkillMapping(Model, frozen=True, json_schema_extra=exactly_one("topic", "service", "action")):
    """`via` of a skill: exactly one of these."""

    topic: TopicSkill | None = None
    """Publish a message, then wait for a condition on a topic."""
    service: ServiceSkill | None = None
    """Call a service."""
    action: ActionSkill | None = None
    """Give a goal to an action server: a ROS 2 action, or actionlib in ROS 1."""

    @model_validator(mode="after")
    def _exactly_one(self) -> RosSkillMapping:
        given = [name for name in ("topic", "service", "action") if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of topic, service, action; there is {listed(given) or 'none'}")
        return self

    @property
    def way(self) -> TopicSkill | ServiceSkill | ActionSkill:
        """The one that is given."""
        way = self.topic or self.service or self.action
        assert way is not None
        return way


@dataclass(frozen=True)
class SkillSpec(ConfiguredSkill[RosSkillMapping]):
    """One configured skill of a ROS robot; without `via` the robot's own program offers it."""

    @property
    def request_topic(self) -> str:
        """Where a robot's own program hears requests; they originate in the server's space."""
        return Topic(SERVER_SPACE, self.topic.ns, self.topic.id).name

    @property
    def status_topic(self) -> str:
        """Where a robot's own program tells of its executions."""
        return self.topic.name

    def offer(self) -> Skill:
        """As the bridge announces it. Only a robot's own program can stand in the middle of a skill and go on."""
        return replace(super().offer(), can_suspend=self._way is None)

    @property
    def limits(self) -> SkillLimits:
        """One at a time where the robot's answers on a topic do not say which execution they mean."""
        limits = self.config.limits.model()
        return replace(limits, requests_at_once=1) if isinstance(self._way, TopicSkill) else limits

    @property
    def _way(self) -> TopicSkill | ServiceSkill | ActionSkill | None:
        return self.via.way if self.via is not None else None


def skill_problems(robots: Mapping[str, RobotConfig]) -> Iterator[tuple[KeyPath, str, str]]:
    """What in `via` of these robots' skills names no argument or result; as BridgeConfig.problems has it."""
    for robot_name, robot in robots.items():
        for name, skill in robot.skills.items():
            try:
                via = RosSkillMapping.model_validate(skill.via) if skill.via else None
            except ValidationError:
                continue  # that is a problem already
            if via is not None:
                yield from _via_problems(("robots", robot_name, "skills", name), name, skill, via)


def _via_problems(
    path: KeyPath, name: str, skill: SkillConfig, via: RosSkillMapping
) -> Iterator[tuple[KeyPath, str, str]]:
    way = via.way
    inner: KeyPath = (*path, "via", next(key for key in ("topic", "service", "action") if getattr(via, key) is way))
    response, of_response = (way.status, (*inner, "status")) if isinstance(way, TopicSkill) else (way, inner)
    if isinstance(way, TopicSkill) and way.status is not None and way.status.halted is not None and way.halt is None:
        yield (*of_response, "halted"), "nothing stops the robot", "add `halt`, or remove it"
    for argument in way.fields:
        if argument not in skill.arguments:
            said = f"{name} has no argument `{argument}`"
            yield (*inner, "fields", argument), said, closest(argument, skill.arguments)
    if response is None:
        if skill.results:
            yield (*path, "results"), "a topic without `status` brings no results", "add `status`, or remove them"
        return
    for result in response.results:
        if result not in skill.results:
            yield (*of_response, "results", result), f"{name} has no result `{result}`", closest(result, skill.results)
    for key in ("running", "done", "failed", "halted", "progress", "success"):
        text: str | None = getattr(response, key, None)
        for used in sorted(parse_expression(text).names) if text is not None else ():
            argument = used.removeprefix(ARGUMENTS)
            if argument != used and argument not in skill.arguments:
                yield (*of_response, key), f"{name} has no argument `{argument}`", closest(argument, skill.arguments)


def skill_specs(config: FleetConfig, bridge_name: str) -> tuple[SkillSpec, ...]:
    """The skills of the robots behind a bridge. A skill, or a robot, that has no id yet is left out."""
    return tuple(
        [
            SkillSpec(skill.robot, skill.name, skill.topic, skill.status, skill.config, skill.via)
            for skill in configured_skills(config, bridge_name, RosSkillMapping)
        ]
    )
