"""The parts of a bridge, made and joined; `shell` calls them from the event loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ua_fleet.bridge.actions import Actions
from ua_fleet.bridge.carry import CarryFactory, CarryGround
from ua_fleet.bridge.configured import every_data_set
from ua_fleet.bridge.core import BridgeCore, Rule
from ua_fleet.bridge.driver import Driver, DriverEvent
from ua_fleet.bridge.execution_log import ExecutionLog
from ua_fleet.bridge.figures import BridgeFigures
from ua_fleet.bridge.inlet import BoundedInlet
from ua_fleet.bridge.lag import LagMeter
from ua_fleet.bridge.rival import Rival
from ua_fleet.bridge.status import status_topic
from ua_fleet.bridge.switching import BridgeSwitches
from ua_fleet.bridge.teleoperation import BridgeTeleoperation
from ua_fleet.bridge.wanted import Wants
from ua_fleet.config.applications import bridge_application
from ua_fleet.config.nodes import mapped_sources, max_ages_of, writer_settings
from ua_fleet.config.registration import announced_robots
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import publisher_ids
from ua_fleet.config.teleoperation import setpoint_groups, teleoperations
from ua_fleet.config.transports import connections_of
from ua_fleet.counters import Counters
from ua_fleet.fleet.wanted import wanted_topic
from ua_fleet.keys.keeper import KeysKept
from ua_fleet.monitoring import Mistakes
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.skill.journal import ResponderJournal
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.storage.lease_numbers import LeaseNumbers
from ua_fleet.topics import Topic
from ua_fleet.transport.base import Address, Transport
from ua_fleet.transport.connections import Sender
from ua_fleet.transport.paced import PacedSender
from ua_fleet.transport.sealed import Sent
from ua_fleet.values import ticks_from_unix_ns
from ua_fleet.wire import Codec

__all__ = ["BridgeGiven", "BridgeParts", "ShellCalls", "wall_ticks"]


def wall_ticks() -> int:
    """The time of the wall clock."""
    return ticks_from_unix_ns(time.time_ns())


@dataclass(frozen=True, slots=True)
class BridgeGiven:
    """What a bridge is made of; see `run_bridge`."""

    config: FleetConfig
    name: str
    driver: Driver
    transports: Transport | Sequence[Transport]
    state_dir: Path
    journal: ResponderJournal
    rule: Rule
    sent: Sent | None
    mistakes: Mistakes
    carry: CarryFactory | None


class ShellCalls(Protocol):
    """What the parts have to say to the shell."""

    def receive(self, datagram: bytes, sender: Address, *, is_fresh: bool = True, connection: int = 0) -> None:
        """A datagram has come from a transport, or what its broker had kept."""
        ...

    def from_space(self, event: DriverEvent) -> None:
        """The driver has said something."""
        ...

    def failed(self, text: str, error: BaseException | None) -> None:
        """An operator has to know this."""
        ...

    def arm(self) -> None:
        """The next deadline may have come nearer."""
        ...


class BridgeParts:
    """All parts of one bridge, each made after those that it needs."""

    def __init__(self, given: BridgeGiven, shell: ShellCalls, loop: asyncio.AbstractEventLoop, log: Any) -> None:
        """Make them; nothing works yet."""
        config, bridge = given.config, given.config.bridges[given.name]
        self._given, self._shell, self._bridge = given, shell, bridge
        self._loop, self._log, self._driver = loop, log, given.driver
        self._max_ages = max_ages_of(config)
        self.status_topic = status_topic(config, bridge)
        self.counters, self.keys, self.rival, self._lag = Counters(), KeysKept(), Rival(), LagMeter()
        self.connections = connections_of(config, bridge.space, self.counters, given.state_dir, given.transports)
        codec = Codec(packed_arrays=given.driver.takes_packed_arrays)
        self.subscriber = self._make_subscriber(codec)
        self.publisher = self._make_publisher(codec)
        self.publisher.timestamps.told = self._clock_set_back
        self.connections.speak_for(
            bridge.space,
            shell.receive,
            self.publisher.names_of,
            taken_over=lambda: self.rival.heard(("the broker", 0), self._loop.time()),
        )
        self.sender = Sender(self.connections, self._make_paced(), self.counters)
        self._send = self.sender.send if given.carry is None else self._send_and_tell
        self.core = self._make_core()
        self.actions = self.core.actions = self._make_actions()
        self.switches = self.core.switches = self._make_switches()
        self.actions.rival = self._not_now
        if given.carry is not None:
            self.core.carrying = given.carry(self._carry_ground())
        self.teleoperation = self.core.teleoperation = self._make_teleoperation()
        if self.connections.know_themselves:
            self.subscriber.impostor = self._is_impostor
        self._data_of: dict[str, set[Topic]] = {}
        """The data of each robot of `fleet.yaml`."""
        for robot, _, topic, _ in every_data_set(config):
            self._data_of.setdefault(robot, set()).add(topic)
        self.inlet = BoundedInlet(
            self._loop,
            config.pubsub.inlet_size,
            shell.from_space,
            max_wait_s=config.pubsub.max_wait_s,
            max_ages=self._max_ages,
            lag=self._lag,
            sources_of=self._sources_of,
        )
        self.figures = BridgeFigures(
            self.counters, self._driver, self.connections, self.inlet, self.keys, self._lag, self.sender
        )

    # PubSub.

    def _make_subscriber(self, codec: Codec) -> Subscriber:
        config = self._given.config
        first, *further = self.connections.all
        subscriber = Subscriber(
            self._bridge.space,
            config.pubsub.timing(),
            self.counters,
            codec,
            self._given.rule,
            envelope=first.envelope,
            barred=first.barred,
            relayed=first.relayed,
            takes_actions=first.takes_actions,
            max_ages=self._max_ages,
            mapped=mapped_sources(config),
            publisher_ids=publisher_ids(config),
            setpoint_groups=setpoint_groups(config),
        )
        for each in further:
            subscriber.add_connection(
                each.envelope, barred=each.barred, relayed=each.relayed, takes_actions=each.takes_actions
            )
        return subscriber

    def _make_publisher(self, codec: Codec) -> Publisher:
        config = self._given.config
        return Publisher(
            self._bridge.space,
            config.pubsub.timing(),
            self.counters,
            codec,
            bridge_application(config, self._given.name),
            max_packed_bytes=self.connections.envelopes.max_plain_bytes,
            settings=writer_settings(config),
        )

    def _make_paced(self) -> list[PacedSender]:
        return [
            PacedSender(
                each.envelope,
                each.transport,
                self._loop.time,
                self._loop.call_at,
                self.counters,
                self._given.sent,
                arrived=lambda: self.inlet.arrived_at,
                gone=self._lag.observe,
            )
            for each in self.connections.all
        ]

    def _send_and_tell(self, datagram: bytes) -> None:
        """Send to all, and tell who carries runs here: nobody hears a bridge itself."""
        self.sender.send(datagram)
        if self.core.carrying is not None:
            self.core.carrying.own(datagram)

    def _is_impostor(self, sender: Address, now: float) -> bool:
        """Whether somebody else says that it is this bridge."""
        if self.connections.is_own(sender):
            return False
        self.rival.heard(sender, now)
        return True

    # The core, and what it has beside it.

    def _make_core(self) -> BridgeCore:
        space, driver = self._bridge.space, self._driver
        core = BridgeCore(
            space,
            self.publisher,
            self.subscriber,
            self.counters,
            send=self._send,
            publish=driver.publish,
            rule=self._given.rule,
            max_ages=self._max_ages,
        )
        core.caught, core.dropped = self._given.mistakes.caught, self._shell.from_space
        if self.status_topic is not None:
            data_sets = every_data_set(self._given.config)
            namespaces = {topic.id: topic.ns for _, _, topic, _ in data_sets if topic.space == space}
            core.wants = Wants(wanted_topic(self.status_topic), space, driver.want, namespaces)
        core.stale = driver.stale
        return core

    def _make_actions(self) -> Actions:
        return Actions(
            self._bridge.space,
            self.publisher,
            self.counters,
            driver=self._driver,
            journal=self._given.journal,
            requestors=self._bridge.requestors,
            must_be_verified=self.connections.must_be_verified,
            core=self.core,
            send=self._send,
            send_to=self.sender.send,
            wall_ticks=wall_ticks,
            failed=self._shell.failed,
            followed=ExecutionLog(self._log).take,
            rule=self._given.rule,
            definitions=announced_robots(self._given.config, self._given.name),
            answers=self.connections.answer_address,
            limits=self._limits(),
        )

    def _make_switches(self) -> BridgeSwitches:
        return BridgeSwitches(
            self._given.name,
            self._bridge.space,
            self._given.config.fleet.namespace_index,
            self.publisher,
            self.subscriber,
            self.counters,
            requestors=self._bridge.requestors,
            must_be_verified=self.connections.must_be_verified,
            send=self._send,
            send_to=self.sender.send,
            wall_ticks=wall_ticks,
            hear=self.core.hear,
            told=self._switched,
            failed=self._shell.failed,
            caught=self._given.mistakes.caught,
            answers=self.connections.answer_address,
            limits=self._limits(),
        )

    def _carry_ground(self) -> CarryGround:
        return CarryGround(
            self.publisher,
            self.subscriber,
            self.core,
            self.actions,
            self.counters,
            self._given.mistakes,
            self._loop,
            send=self.sender.send,
            send_to=self.sender.send,
            wall_ticks=wall_ticks,
            sooner=self._shell.arm,
            must_be_verified=self.connections.must_be_verified,
            answers=self.connections.answer_address,
            limits=self._limits(),
        )

    def _make_teleoperation(self) -> BridgeTeleoperation | None:
        """The robots that are driven by hand; None where there are none."""
        if not (models := teleoperations(self._given.config, self._given.name)):
            return None
        driven = BridgeTeleoperation(
            self._bridge.space,
            models,
            self.publisher,
            self.counters,
            driver=self._driver,
            core=self.core,
            next_number=LeaseNumbers(self._given.state_dir).next,
            requestors=self._bridge.requestors,
            must_be_verified=self.connections.must_be_verified,
            busy=self.actions.busy,
            send=self.sender.send,
            send_to=self.sender.send,
            wall_ticks=wall_ticks,
            caught=self._given.mistakes.caught,
            told=lambda text, robot, detail: self._log.info(text, robot=robot, detail=detail),
            loop=self._loop,
            answers=self.connections.answer_address,
            limits=self._limits(),
        )
        self.actions.driven_by = driven.driven_by
        return driven

    def _limits(self) -> ResponderLimits:
        """A broker may hold a request back for as long as it likes, so that none is taken after its TimeoutHint."""
        return ResponderLimits(late_tolerance_s=0.0) if self.connections.are_brokered else ResponderLimits()

    def _switched(self, component: str, is_enabled: bool) -> None:
        self._log.warning("PubSub was switched", component=component, state="enabled" if is_enabled else "disabled")

    def _clock_set_back(self, topic: Topic, back_s: float) -> None:
        self._log.warning(
            "the clock of this computer was ahead and was set back: values have earlier times than those before, and "
            "readers take them some seconds later; let NTP keep the clock",
            source=topic.name,
            back_s=round(back_s),
        )

    def _not_now(self, now: float) -> str:
        """Why nothing may be begun now; empty where it may."""
        return self.rival.problem(now) or self.switches.problem

    def _sources_of(self, execution_id: bytes) -> Collection[Topic]:
        """The data of the robot that an execution belongs to."""
        return self._data_of.get(self.actions.robot_of(execution_id) or "", ())
