"""What `fleet.yaml` says alike for the bridges of ROS 1 and ROS 2."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, ClassVar, Final, Literal

from pydantic import BaseModel, Field

from ua_bridges.ros.installed import ros_type_problems
from ua_bridges.ros.skills import RosSkillMapping, skill_problems
from ua_bridges.ros.topic_mapping import TopicMapping, absolute
from ua_bridges.ros.type_checks import message_type_findings
from ua_fleet.config.schema import BridgeConfig, DataMapping, DataSetConfig, MachineFinding, RobotConfig
from ua_fleet.document import KeyPath, key_text

__all__ = ["RosBridgeConfig", "topic_problems"]

Problem = tuple[KeyPath, str, str]
Robots = Mapping[str, RobotConfig]

_UA_TOPIC: Final = re.compile(r"/?ua_[0-9]")


class RosBridgeConfig(BridgeConfig, frozen=True):
    """A bridge into a ROS graph."""

    node_name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")] = "ua_bridge"
    """Name of the bridge's node in the graph."""

    skill_mapping: ClassVar[type[BaseModel] | None] = RosSkillMapping
    source_mapping: ClassVar[type[DataMapping] | None] = TopicMapping
    sink_mapping: ClassVar[type[DataMapping] | None] = TopicMapping
    takes_setpoints: ClassVar[bool] = True
    ros: ClassVar[Literal[1, 2]]
    """The version of ROS."""

    def problems(self, name: str, robots: Robots) -> Iterable[Problem]:
        """See BridgeConfig."""
        yield from topic_problems(robots)
        yield from _setpoint_problems(robots)
        yield from skill_problems(robots)

    def fleet_problems(self, name: str, robots: Robots) -> Iterable[Problem]:
        """See BridgeConfig."""
        yield from super().fleet_problems(name, robots)
        yield from ros_type_problems(robots, name)

    def findings_here(self, name: str, robots: Robots) -> Iterable[tuple[KeyPath, MachineFinding]]:
        """See BridgeConfig."""
        return message_type_findings(robots, name, self.ros)


def _mapped(robots: Robots) -> Iterator[tuple[KeyPath, str, DataSetConfig, TopicMapping]]:
    """What of the robots' data is mapped: the path of its key, `source` or `sink`, the data, and the topic."""
    for robot, config in robots.items():
        for name, data in config.data.items():
            for side, mapping in (("source", data.source), ("sink", data.sink)):
                if isinstance(mapping, TopicMapping):
                    yield ("robots", robot, "data", name), side, data, mapping


def topic_problems(robots: Robots) -> Iterator[Problem]:
    """Topics of a bridge's robots that are UA topics, have two types, or have a member that two data write."""
    first_of: dict[str, tuple[KeyPath, TopicMapping]] = {}
    writers: dict[tuple[str, str], KeyPath] = {}
    for path, side, data, mapping in _mapped(robots):
        topic = absolute(mapping.topic)
        if _UA_TOPIC.match(mapping.topic):
            text = f"{mapping.topic} is a UA topic, which is bridged without being named here"
            yield (*path, side, "topic"), text, f"remove `{side}`"
        if side == "sink":
            yield from _sink_problems(writers, topic, path, data)
        first_path, first = first_of.setdefault(topic, (path, mapping))
        if first.message_type != mapping.message_type:
            text = f"{mapping.topic} has the type {first.type} in {key_text(first_path)}"
            yield (*path, side, "type"), text, "a topic has one type; correct one of them"


def _sink_problems(
    writers: dict[tuple[str, str], KeyPath], topic: str, path: KeyPath, data: DataSetConfig
) -> Iterator[Problem]:
    """Several data sources may write one topic, each its own members of the message."""
    for name, field in data.all_fields().items():
        member = field.path or name or "data"
        first = writers.setdefault((topic, member), path)
        if first != path:
            text = f"{member} of {topic} is written by {key_text(first)} already"
            yield (*path, "sink", "topic"), text, "give one of them another `path` or topic"
            return


def _setpoint_problems(robots: Robots) -> Iterator[Problem]:
    """The topic of setpoints is written at the rate of teleoperation, kept for nobody, and by nothing else."""
    for robot, config in robots.items():
        driven = config.teleoperation
        data = None if driven is None else config.data.get(driven.data)
        if driven is None or data is None or data.origin != "server" or not isinstance(data.sink, TopicMapping):
            continue
        own: KeyPath = ("robots", robot, "data", driven.data)
        sink = data.sink
        if sink.latched or sink.qos.durability == "transient_local":
            key = "latched" if sink.latched else "qos"
            yield (*own, "sink", key), "a setpoint must not be kept for late subscribers", "remove it"
        if sink.max_rate_hz is not None:
            text = "setpoints are written each `period_ms` of teleoperation"
            yield (*own, "sink", "max_rate_hz"), text, "remove it"
        for path, side, _, mapping in _mapped(robots):
            if path != own and side == "sink" and absolute(mapping.topic) == absolute(sink.topic):
                text = f"{sink.topic} is written by {path[1]}.{path[3]} too, and a robot has one commander"
                yield ("robots", robot, "teleoperation", "data"), text, "give one of them another topic"
