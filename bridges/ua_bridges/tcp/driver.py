"""The driver for a robot that speaks over TCP: its connections, and which of them a skill or a value takes."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from ua_bridges.tcp.config import TcpBridgeConfig, TcpSink, TcpSkillMapping, TcpSource
from ua_bridges.tcp.data import RobotData, faults_of
from ua_bridges.tcp.direct import DirectSession
from ua_bridges.tcp.interpreter import InterpreterSession, TcpSkill
from ua_bridges.tcp.link import Link
from ua_fleet.bridge.configured import (
    configured_sinks,
    configured_skills,
    configured_sources,
    every_data_set,
    field_order,
)
from ua_fleet.bridge.driver import Driver, DriverStatus, Dropped, Execution, Inlet, Skill
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["TcpDriver", "create_driver"]


def _is_direct(skill: TcpSkill) -> bool:
    return skill.via is not None and skill.via.direct is not None


def _is_sent_direct(data: RobotData) -> bool:
    return data.side.direct is not None


class TcpDriver(Driver):
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, TcpBridgeConfig)
        self._config, self._name = bridge, bridge_name
        self._skills = {skill.topic: skill for skill in configured_skills(config, bridge_name, TcpSkillMapping)}
        self._offers = tuple([skill.offer() for skill in self._skills.values()])
        self._sources = configured_sources(config, bridge_name, TcpSource, TcpSource())
        self._faults = faults_of(config, bridge_name)
        sinks = configured_sinks(config, bridge_name, TcpSink, TcpSink())
        self._sinks = {data.topic: data for data in sinks}
        self._direct_link: Link | None = None
        self._interpreter_link: Link | None = None
        self._direct: DirectSession | None = None
        self._interpreter: InterpreterSession | None = None
        self._answers = _topics_of(config, bridge.answers)
        self._orders = {
            topic: field_order(robot, name, data)
            for robot, name, topic, data in every_data_set(config)
            if topic in self._answers
        }
        self._known: dict[str, tuple[Any, ...] | None] = dict.fromkeys(self._answers.values())
        """What the program is answered: None for what is not of now."""
        self._last = dict(self._known)
        self._inlet: Inlet | None = None

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet = inlet
        self._offenders = offenders = Offenders(inlet)
        config, now = self._config, time.monotonic()
        if (direct := config.direct) is not None:
            self._direct_link = link = Link(f"{self._name} (direct)", offenders, direct.connect)
            skills = [skill for skill in self._skills.values() if _is_direct(skill)]
            both: list[RobotData] = [*self._sources, *self._sinks.values()]
            data = [each for each in both if _is_sent_direct(each)]
            self._direct = DirectSession(direct, skills, data, inlet.put, link.write, link.reset, link.misbehaves, now)
            link.start(self._direct)
        if (program := config.interpreter) is not None:
            who = f"{self._name} (interpreter)"
            self._interpreter_link = link = Link(
                who, offenders, program.connect, program.listen, program.peer, inlet.put
            )
            sources = [each for each in (*self._sources, *self._faults) if not _is_sent_direct(each)]
            self._interpreter = InterpreterSession(
                program, sources, inlet.put, link.write, link.reset, link.misbehaves, now
            )
            self._interpreter.answer_from(self._known)
            link.start(self._interpreter)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        assert self._inlet is not None
        wanted = self._answers.get(topic)
        if wanted is not None:
            self._known[wanted] = self._last[wanted] = self._orders[topic].arranged(metadata, message.values)
        sink = self._sinks.get(topic)
        if sink is None:
            if wanted is None:
                self._inlet.put(Dropped(Drop.UNMAPPED))
            return wanted is not None
        if self._direct is not None and self._direct.writes(topic):
            return self._direct.inform(topic, sink.order.arranged(metadata, message.values))
        assert self._interpreter is not None
        done = self._interpreter.inform(sink, sink.order.arranged(metadata, message.values), time.monotonic())
        self._look()
        return done

    def stale(self, topic: Topic, is_stale: bool) -> None:
        """See Driver."""
        if (name := self._answers.get(topic)) is not None:
            self._known[name] = None if is_stale else self._last[name]

    def status(self) -> DriverStatus:
        """See Driver."""
        links = [link for link in (self._direct_link, self._interpreter_link) if link is not None]
        sessions = [session for session in (self._direct, self._interpreter) if session is not None]
        is_connected = bool(sessions) and all(session.is_connected for session in sessions)
        pairs = zip(("direct", "interpreter"), links, sessions, strict=False) if len(sessions) > 1 else ()
        each = {name: "" if session.is_connected else link.detail for name, link, session in pairs}
        aside = self._offenders.told(time.monotonic()) if self._inlet is not None else dict[str, str]()
        return DriverStatus(is_connected, "; ".join(link.detail for link in links) or "not started", each, aside)

    async def stop(self) -> None:
        """See Driver."""
        for link in (self._direct_link, self._interpreter_link):
            if link is not None:
                link.stop()

    # Skills

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        return self._offers

    def _session(self, skill: TcpSkill) -> DirectSession | InterpreterSession:
        session = self._direct if _is_direct(skill) else self._interpreter
        assert session is not None
        return session

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        skill = self._skills[execution.topic]
        self._session(skill).execute(skill, execution, time.monotonic())
        self._look()

    def query(self, execution: Execution) -> None:
        """See Driver."""
        skill = self._skills[execution.topic]
        self._session(skill).query(skill, execution, time.monotonic())
        self._look()

    def halt(self, execution: Execution) -> None:
        """See Driver."""
        self._session(self._skills[execution.topic]).halt(execution, time.monotonic())

    def _look(self) -> None:
        now = time.monotonic()
        for link, session in ((self._direct_link, self._direct), (self._interpreter_link, self._interpreter)):
            if link is not None and session is not None:
                link.look(now)


def _topics_of(config: FleetConfig, answers: Sequence[str]) -> dict[Topic, str]:
    """Topics of other robots' data by their names `robot.data`; config check has seen that they exist."""
    labels = {f"{robot}.{name}": topic for robot, name, topic, _ in every_data_set(config)}
    return {labels[name]: name for name in answers if name in labels}


def create_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """The driver of the TCP bridge with this name in `fleet.yaml`."""
    return TcpDriver(config, bridge_name)
