"""A recording of a small fleet, made without a network."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tests.unit.pubsub.publishing import CODEC, FIELDS, WALL
from tests.unit.pubsub.security.securing import envelope, key_data
from ua_fleet.counters import Counters
from ua_fleet.pubsub import Publisher, PubSubTiming
from ua_fleet.pubsub.layout import WriterSettings
from ua_fleet.recording.records import Connection, Header, Record, key_name
from ua_fleet.topics import Topic
from ua_fleet.values import unix_ns_from_ticks
from ua_fleet.wire import SecurityMode, encode_action
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage
from ua_fleet.wire.security import MessageKey, SecurityPolicy

ARM, LEG = Topic(1, 2, 1001), Topic(1, 2, 1002)
SENDER = ("192.0.2.7", 50_000)
BEGUN_NS = unix_ns_from_ticks(WALL)
SETPOINTS = {7000: 1}
HEADER = Header(BEGUN_NS, (Connection("opc.udp://224.0.2.14:4840", "eth0"),), ((7000, 1),))


def setpoint() -> bytes:
    part = DataSetMessage(5, types=(11,), values=(1.0,), sequence_number=1)
    return CODEC.encode(NetworkMessage(0, writer_group_id=7000, messages=(part,)))


def action() -> bytes:
    message = ActionMessage(
        1, 2, 7, 1, 1, ActionState.EXECUTING, is_request=True, requestor_id="0.a", correlation_data=b"x"
    )
    return encode_action(message)


@dataclass
class Recording:
    """What a recorder writes while space 1 publishes."""

    mode: SecurityMode = SecurityMode.NONE
    settings: dict[Topic, WriterSettings] = field(default_factory=dict[Topic, WriterSettings])
    now: float = 0.0
    records: list[Record] = field(default_factory=list[Record])

    def __post_init__(self) -> None:
        self.publisher = Publisher(1, PubSubTiming(), Counters(), CODEC, settings=self.settings)
        groups = () if self.mode is SecurityMode.NONE else ("t-1", "c-1")
        self.envelope = envelope(1, *groups, mode=self.mode, max_datagram_bytes=1400)

    def add(self, *plain: bytes) -> None:
        for message in plain:
            for datagram in self.envelope.seal(message, 0.0):
                time_ns = BEGUN_NS + round(self.now * 1e9)
                self.records.append(Record(time_ns, 0, SENDER, key_name(datagram, SETPOINTS), datagram))

    def announce(self, topic: Topic, **changes: Any) -> None:
        arguments: dict[str, Any] = {"fields": FIELDS, **changes}
        self.add(*self.publisher.announce(topic, f"data {topic.id}", now=self.now, wall_ticks=WALL, **arguments))

    def publish(self, topic: Topic, level: float, name: str = "a", status: int = 0) -> None:
        stamp = WALL + round(self.now * 1e7)
        self.add(*self.publisher.publish(topic, (level, name), timestamp=stamp, status=status, now=self.now))


def keys() -> dict[str, MessageKey]:
    policy = SecurityPolicy.AES256_CTR
    return {f"t-1/{token}": MessageKey(policy, key_data(token, "0t-1")) for token in (1, 2, 3)}
