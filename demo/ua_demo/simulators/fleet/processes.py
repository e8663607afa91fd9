"""A bridge, and what each process is given: the parts of the real ones, without event loop and disk.

`bridge.runner` is what a machine has in its place. What is left out here sends nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Final

from ua_demo.simulators.fleet.memory import VirtualLoop
from ua_demo.simulators.fleet.robot import VirtualRobot
from ua_fleet.bridge.actions import Actions
from ua_fleet.bridge.carry import CarryFactory, CarryGround
from ua_fleet.bridge.core import BridgeCore
from ua_fleet.bridge.driver import DriverStatus, SourceFound
from ua_fleet.bridge.status import STATUS_FIELDS, STATUS_INTERVAL_S, status_topic, status_values
from ua_fleet.config.applications import bridge_application
from ua_fleet.config.registration import announced_robots
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Counters
from ua_fleet.errors import ScenarioError
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.pubsub.application import Application
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security import Envelope
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.skill.responder import ResponderLimits
from ua_fleet.transport.addresses import answer_address
from ua_fleet.transport.base import Address
from ua_fleet.transport.sealed import SealedSender
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire import Codec

__all__ = ["Place", "VirtualBridge", "nothing", "wall_ticks"]

START_TICKS: Final = 134_116_128_000_000_000
"""The wall clock at time 0: 2026-01-01 UTC."""


def wall_ticks(now: float) -> int:
    """The wall clock of all processes."""
    return START_TICKS + round(now * TICKS_PER_SECOND)


@dataclass(frozen=True, slots=True)
class Place:
    """What a process is given: its own clock, way into the network, keys and counters."""

    timing: PubSubTiming
    counters: Counters
    envelope: Envelope
    """With its keys."""
    sender: SealedSender
    clock: Callable[[], float]
    """Seconds."""
    random: Random
    """Spreads probes."""

    def publisher(self, space: int, application: Application) -> Publisher:
        """Its DataSetWriters."""
        most = self.envelope.max_plain_bytes
        return Publisher(space, self.timing, self.counters, Codec(), application, max_packed_bytes=most)

    def subscriber(self, space: int) -> Subscriber:
        """Its DataSetReaders."""
        return Subscriber(space, self.timing, self.counters, Codec(), envelope=self.envelope, random=self.random)

    def wall_ticks(self) -> int:
        """The wall clock."""
        return wall_ticks(self.clock())


class VirtualBridge:
    """One bridge with its robot."""

    def __init__(
        self, config: FleetConfig, name: str, robot: VirtualRobot, place: Place, carry: CarryFactory | None = None
    ) -> None:
        """Put a bridge together; it begins with its first `poll`.

        Args:
            config: the fleet.
            name: of the bridge.
            robot: its driver.
            place: where it lives.
            carry: makes who carries runs in it; without, it carries none.
        """
        bridge = config.bridges[name]
        self.counters = place.counters
        self._name, self._kind, self._robot, self._clock = name, bridge.kind, robot, place.clock
        self._send, self._loop, self._mistakes = place.sender.send, VirtualLoop(place.clock), Mistakes()
        publisher, subscriber = (
            place.publisher(bridge.space, bridge_application(config, name)),
            place.subscriber(bridge.space),
        )
        send = self._send if carry is None else self._send_and_tell
        self._core = BridgeCore(
            bridge.space,
            publisher,
            subscriber,
            place.counters,
            send=send,
            publish=robot.publish,
        )
        self._actions = self._core.actions = Actions(
            bridge.space,
            publisher,
            place.counters,
            driver=robot,
            journal=MemoryJournal(),
            requestors=bridge.requestors,
            must_be_verified=True,
            core=self._core,
            send=send,
            send_to=place.sender.send,
            wall_ticks=place.wall_ticks,
            failed=_raise,
            definitions=announced_robots(config, name),
            skills_period_s=math.inf,  # a virtual robot's never change
        )
        if carry is not None:
            self._core.carrying = carry(self._carry_ground(publisher, subscriber, place))
        topic = status_topic(config, bridge)
        assert topic is not None, "fleet_of gives each bridge one"
        self._status_topic = topic
        self._status_period_s = STATUS_INTERVAL_S * place.timing.keep_alive_s / PubSubTiming().keep_alive_s
        self._status_at = 0.0
        self._has_begun = False

    def _carry_ground(self, publisher: Publisher, subscriber: Subscriber, place: Place) -> CarryGround:
        """What who carries runs here is given."""
        return CarryGround(
            publisher,
            subscriber,
            self._core,
            self._actions,
            place.counters,
            self._mistakes,
            self._loop,
            send=self._send,
            send_to=self._send,
            wall_ticks=place.wall_ticks,
            sooner=nothing,
            must_be_verified=True,
            answers=answer_address,
            limits=ResponderLimits(),
        )

    def receive(self, datagram: bytes, sender: Address) -> None:
        """Take a datagram."""
        self._core.from_pubsub(datagram, now=self._clock(), sender=sender)
        self._end_turn()

    def poll(self) -> None:
        """Do what is due."""
        now = self._clock()
        wall = wall_ticks(now)
        if not self._has_begun:
            self._has_begun = True
            self._begin(now, wall)
        for event in self._robot.poll(now):
            self._core.from_space(event, now=now, wall_ticks=wall)
        if now >= self._status_at:
            self._status_at = now + self._status_period_s
            status = DriverStatus(connected=True, detail="a virtual robot")
            self._core.tell(
                self._status_topic, status_values(self._name, self._kind, status, self.counters), wall, now=now
            )
        self._core.poll(now, wall)
        self._end_turn()

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        if not self._has_begun:
            return 0.0
        deadlines = (
            self._core.next_deadline(),
            self._robot.next_deadline(),
            self._loop.next_deadline(),
            self._status_at,
        )
        return min(deadline for deadline in deadlines if deadline is not None)

    def _begin(self, now: float, wall: int) -> None:
        self._core.begin(now=now, wall_ticks=wall)
        source = SourceFound(self._status_topic, f"{self._name} status", STATUS_FIELDS)
        self._core.from_space(source, now=now, wall_ticks=wall)
        self._actions.begin(now)
        if self._core.carrying is not None:
            self._core.carrying.begin(now)

    def _send_and_tell(self, datagram: bytes) -> None:
        """Send to all, and tell who carries runs here: nobody hears a bridge itself."""
        self._send(datagram)
        if self._core.carrying is not None:
            self._core.carrying.own(datagram)

    def _end_turn(self) -> None:
        """Do what was put off to the end of the turn; what would cost a bridge an item must not happen here."""
        self._loop.run_ready()
        if self._mistakes.count:
            raise ScenarioError(f"the simulation is wrong: {self._mistakes.text()}")


def nothing() -> None:
    """The world asks for the next deadline after everything that it has had a process do."""


def _raise(text: str, error: BaseException | None) -> None:
    """What a bridge would log for an operator must not happen here."""
    raise ScenarioError(f"the simulation is wrong: {text}") from error
