# pyright: basic, reportMissingImports=false
"""The ROS 2 driver whose robots have skills."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import structlog

from ua_bridges.ros.executing import Executing
from ua_bridges.ros.skills import ActionSkill, ServiceSkill, SkillSpec, TopicSkill
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.feed import Read
from ua_bridges.ros2.graph import LOOK_S
from ua_bridges.ros2.node import Ros2Node, guarded
from ua_bridges.ros2.session import Ros2Driver
from ua_bridges.ros2.skills.action import ActionPort
from ua_bridges.ros2.skills.port import SkillPort
from ua_bridges.ros2.skills.program import ProgramPort
from ua_bridges.ros2.skills.service import ServicePort
from ua_bridges.ros2.skills.topic import TopicPort
from ua_bridges.ros2.watch import Heard
from ua_fleet.bridge.driver import DriverEvent, Execution, ExecutionForgotten, Inlet, Skill
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.topics import Topic

__all__ = ["SkilledRos2Driver"]

_log = structlog.get_logger("ua_bridges.ros2")


def _make_port(spec: SkillSpec, executing: Executing, put: Callable[[DriverEvent], None]) -> SkillPort:
    way = spec.via.way if spec.via is not None else None
    if isinstance(way, TopicSkill):
        return TopicPort(spec, way, executing, put)
    if isinstance(way, ServiceSkill):
        return ServicePort(spec, way, executing, put)
    if isinstance(way, ActionSkill):
        return ActionPort(spec, way, executing, put)
    return ProgramPort(spec, executing, put)


class _SkillFeed:
    """What is heard on a port's topic; see `ua_bridges.ros2.feed.Feed`."""

    def __init__(self, port: SkillPort, name: str, wanted_type: str) -> None:
        self._port, self._name, self._wanted = port, name, wanted_type.replace("/msg/", "/")

    def found(self, kind: MessageType, latched: bool) -> None:
        """See Feed."""
        if kind.name == self._wanted:
            self._port.source("")
        else:
            self.mistyped(kind.name, 0)

    def reader(self, kind: MessageType) -> Read:
        """See Feed."""
        heard = self._port.heard
        if kind.name != self._wanted:
            return lambda message, time_ns: None
        return lambda message, time_ns: heard(message)

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """See Feed."""
        said = f"{self._name} carries {ros_type.replace('/msg/', '/')}, and not {self._wanted}; correct `type`"
        self._port.source(said)

    def release(self, now: float) -> float | None:
        """Nothing waits."""
        return None

    def lost(self) -> None:
        """See Feed."""
        self._port.source(f"nobody publishes {self._name}; start the robot's node")


class SkilledRos2Driver(Ros2Driver):
    """See HaltingDriver in `ua_fleet.bridge.driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str, specs: Sequence[SkillSpec]) -> None:
        super().__init__(config, bridge_name)
        self._specs = specs
        self._offers = tuple([spec.offer() for spec in specs])
        self._ports: dict[Topic, SkillPort] = {}
        self._begun_by: dict[bytes, SkillPort] = {}
        self._look_at = 0.0

    # The node's thread

    def _listened(self, inlet: Inlet) -> list[Heard]:
        self._executing = Executing(inlet.put)
        self._ports = {spec.topic: _make_port(spec, self._executing, inlet.put) for spec in self._specs}
        heard: list[Heard] = []
        for port in self._ports.values():
            if (wanted := port.listened()) is not None:
                name, ros_type, qos = wanted
                heard.append(Heard(name, ros_type, qos, _SkillFeed(port, name, ros_type)))
        return heard

    def _opened(self, node: Ros2Node) -> None:
        for port in self._ports.values():
            port.opened(node)
            if port.problem:
                _log.error("a skill cannot be done", robot=port.spec.robot, skill=port.spec.name, why=port.problem)
        super()._opened(node)

    def _turn(self, now: float) -> float:
        due = super()._turn(now)
        if now >= self._look_at:
            self._look_at = now + LOOK_S
            for opened in self._executing.overdue(now):
                port = self._begun_by.get(opened.execution_id)
                if port is not None:
                    guarded(port.overdue)(opened, now)
            for port in self._ports.values():
                guarded(port.turn)(now)
            for execution_id in [each for each in self._begun_by if self._executing.get(each) is None]:
                del self._begun_by[execution_id]
        return min(due, self._look_at)

    def _begin(self, port: SkillPort, execution: Execution, request: Any) -> None:
        self._begun_by[execution.execution_id] = port
        try:
            port.begin(execution, request, time.monotonic())
        except Exception:  # noqa: BLE001 - whatever it was, the robot may have been told
            _log.exception("a skill could not be begun", robot=port.spec.robot, skill=port.spec.name)
            self._executing.forget(execution.execution_id, "the bridge failed while it began this; see its log")

    def _query(self, port: SkillPort, execution: Execution) -> None:
        self._begun_by[execution.execution_id] = port
        port.query(execution, time.monotonic())

    def _cancel(self, execution_id: bytes) -> None:
        port = self._begun_by.get(execution_id)
        if port is not None:
            port.cancel(execution_id, time.monotonic())

    # The event loop's side

    def skills(self) -> Sequence[Skill]:
        """See SkillDriver."""
        return self._offers

    def execute(self, execution: Execution) -> None:
        """See SkillDriver."""
        port = self._ports.get(execution.topic)
        if port is None or not self._thread.running:
            raise RobotOffline(f"the bridge is not in its domain: {self.status().detail}")
        request = port.prepare(execution)
        self._thread.call(partial(self._begin, port, execution, request))

    def query(self, execution: Execution) -> None:
        """See SkillDriver."""
        port = self._ports.get(execution.topic)
        if port is None:
            said = "the skill is no longer in fleet.yaml; see what the robot did"
            self._inlet.put(ExecutionForgotten(execution.execution_id, said))
        else:
            self._thread.call(partial(self._query, port, execution))

    def halt(self, execution: Execution) -> None:
        """See HaltingDriver."""
        port = self._ports.get(execution.topic)
        if port is None or not self._thread.running:
            raise RobotOffline(f"the bridge is not in its domain: {self.status().detail}")
        if port.cannot_stop:
            raise SkillRejected(port.cannot_stop)
        self._thread.call(partial(self._cancel, execution.execution_id))
