"""What the drivers of ROS 1 and ROS 2 have in common where their robots have skills."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from ua_bridges.ros.ports.port import SkillGraph, SkillPort
from ua_bridges.ros.ports.program import ProgramPort
from ua_bridges.ros.ports.skills import MakePort, RobotSkills
from ua_bridges.ros.ports.topic import TopicPort
from ua_bridges.ros.skills import ActionSkill, ServiceSkill, SkillSpec, TopicSkill
from ua_fleet.bridge.driver import Driver, DriverEvent, Execution, Skill
from ua_fleet.bridge.executing import Executing

__all__ = ["SkilledDriver", "port_maker"]

Graph = TypeVar("Graph", bound=SkillGraph)
Put = Callable[[DriverEvent], None]


def port_maker(
    service: Callable[[SkillSpec, ServiceSkill, Executing, Put], SkillPort[Graph]],
    action: Callable[[SkillSpec, ActionSkill, Executing, Put], SkillPort[Graph]],
) -> MakePort[Graph]:
    """Makes the port of a skill; those for services and actions are made by the version of ROS."""

    def make_port(spec: SkillSpec, executing: Executing, put: Put) -> SkillPort[Graph]:
        way = spec.via.way if spec.via is not None else None
        if isinstance(way, TopicSkill):
            return TopicPort(spec, way, executing, put)
        if isinstance(way, ServiceSkill):
            return service(spec, way, executing, put)
        if isinstance(way, ActionSkill):
            return action(spec, way, executing, put)
        return ProgramPort(spec, executing, put)

    return make_port


class SkilledDriver(Driver):
    """The event loop's side of skills."""

    _offers: Sequence[Skill]
    _skills: RobotSkills[Any]

    @abstractmethod
    def _check_node(self) -> None:
        """Raise RobotOffline where the bridge has no node in its graph."""

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        return self._offers

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        self._check_node()
        self._skills.execute(execution)

    def query(self, execution: Execution) -> None:
        """See Driver."""
        self._skills.query(execution)

    def halt(self, execution: Execution) -> None:
        """See Driver."""
        self._check_node()
        self._skills.halt(execution)

    def suspend(self, execution: Execution) -> None:
        """See Driver."""
        self._check_node()
        self._skills.suspend(execution)

    def resume(self, execution: Execution) -> None:
        """See Driver."""
        self._check_node()
        self._skills.resume(execution)
