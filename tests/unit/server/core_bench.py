"""A server's core on a clock that nobody waits for, and the bridge that it hears."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import structlog

from tests.unit.fleet.fleet_of import ROBOTS, fleet_config
from ua_fleet.config.nodes import fleet_model
from ua_fleet.counters import Counters
from ua_fleet.fleet.changes import Change, ValueChanged
from ua_fleet.fleet.commands import Commands
from ua_fleet.fleet.model import UnknownSources
from ua_fleet.fleet.state import FleetState
from ua_fleet.monitoring import Mistakes
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.operation.skills.tracker import SkillTracker, SkillTransitioned
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.server.attached import Ground, NoNodes, Parts
from ua_fleet.server.core import ServerCore
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.topics import Topic
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import FieldMetaData, MetaDataAnnouncement, NetworkMessage, Probe

TIMING: Final = PubSubTiming(1.0, 3.0, 5.0)
RATE_HZ: Final = 10.0
START: Final = 134_000_000_000_000_000
SENDER: Final = ("127.0.0.1", 4840)


class ListedNodes(NoNodes):
    """What clients would see."""

    def __init__(self) -> None:
        self.changes: list[Change | SkillTransitioned] = []
        self.turns = 0

    def begin_turn(self) -> None:
        self.turns += 1

    def write(self, change: ValueChanged) -> None:
        self.changes.append(change)

    def put(self, change: Change | SkillTransitioned) -> None:
        self.changes.append(change)

    def values(self, identifier: int | str) -> list[tuple[Any, int]]:
        """Value and status of each write to a node."""
        return [
            (change.value, change.status)
            for change in self.changes
            if isinstance(change, ValueChanged) and change.key.identifier == identifier
        ]


class Bench:
    """See the module. Time passes in `until` alone."""

    def __init__(
        self,
        robots: Mapping[str, Any] = ROBOTS,
        policy: UnknownSources = UnknownSources.QUARANTINE,
        parts: Parts | None = None,
    ) -> None:
        config = fleet_config(robots)
        self.now, self.model, self.counters, self.mistakes = 0.0, fleet_model(config), Counters(), Mistakes()
        self.nodes = ListedNodes()
        self.sent: list[tuple[float, Any]] = []
        """What the server has said, and when."""
        self._codec = Codec()
        subscriber = Subscriber(0, TIMING, self.counters, Codec())
        self.state = FleetState(self.model, self.counters, unknown_sources=policy)
        self.ground = Ground(
            publisher=Publisher(0, TIMING, self.counters, Codec()),
            subscriber=subscriber,
            counters=self.counters,
            commands=Commands(self.model),
            state=self.state,
            skills=SkillCommands(
                MemoryJournal(),
                send=self._send,
                want=subscriber.want_action,
                sooner=lambda: None,
                wall_ticks=self.wall,
                must_be_verified=False,
                clock=lambda: self.now,
                log=structlog.get_logger(),
            ),
            tracker=SkillTracker(self.model),
            mistakes=self.mistakes,
            log=structlog.get_logger(),
            send=self._send,
        )
        self.core = ServerCore(self.ground, replace(parts or Parts(), nodes=self.nodes), analog_rate_hz=RATE_HZ)
        self.bridge = Publisher(2, TIMING, Counters(), Codec())

    def wall(self) -> int:
        return START + round(self.now * TICKS_PER_SECOND)

    def _send(self, datagram: bytes) -> None:
        self.sent.append((self.now, self._codec.decode(datagram)))

    def begin(self) -> None:
        self.core.begin(now=self.now, wall=self.wall())

    def hear(self, datagrams: Any) -> None:
        """Have the server hear the bridge."""
        for datagram in datagrams:
            self.core.receive(datagram, SENDER, now=self.now, wall=self.wall())

    def announce(self, topic: Topic, *fields: FieldMetaData) -> None:
        self.hear(self.bridge.announce(topic, topic.name, fields, now=self.now, wall_ticks=self.wall()))

    def publish(self, topic: Topic, *values: Any) -> None:
        self.hear(self.bridge.publish(topic, values, timestamp=self.wall(), now=self.now))

    def until(self, end: float, *, bridge: bool = False) -> list[float]:
        """Let time pass, and do what is due at its own time; when that was. The bridge may be there meanwhile."""
        turns: list[float] = []
        while True:
            due = self.core.next_deadline(self.now)
            said = self.bridge.next_deadline() if bridge else None
            at = max(self.now, due if said is None else min(due, said))
            if at > end:
                break
            self.now = at
            if said is not None and said <= at:
                self.hear(self.bridge.poll(at))
            if due <= at:
                turns.append(at)
                self.core.poll(now=at, wall=self.wall())
        self.now = end
        return turns

    def announced(self) -> list[tuple[float, int]]:
        """When the server has announced which DataSetWriter, its id."""
        return [(at, one.data_set_writer_id) for at, one in self.sent if isinstance(one, MetaDataAnnouncement)]

    def published(self) -> list[tuple[float, int]]:
        """When the server has sent values of which DataSetWriter; a keep-alive has none."""
        return [
            (at, part.data_set_writer_id)
            for at, one in self.sent
            if isinstance(one, NetworkMessage)
            for part in one.messages
            if part.values
        ]

    def probes(self) -> list[tuple[float, Probe]]:
        return [(at, one) for at, one in self.sent if isinstance(one, Probe)]
