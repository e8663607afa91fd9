"""A publisher, its envelope and its core of a broker, for the tests of this folder."""

from __future__ import annotations

from tests.unit.pubsub.publishing import FIELDS, TOPIC, WALL
from tests.unit.pubsub.security.securing import envelope
from ua_fleet.counters import Counters
from ua_fleet.pubsub import Application, Publisher, PubSubTiming, describe
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import command_group, telemetry_group
from ua_fleet.transport.mqtt.core import MqttCore, Outgoing
from ua_fleet.transport.mqtt.outbox import Outbox
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.wire import Codec, SecurityMode

BROKERED = Application(describe("urn:test", "bridge floor"), is_brokered=True, url="mqtt://broker:1883")


class Speaking:
    """A publisher of space 1 over a broker."""

    def __init__(self, *, mode: SecurityMode = SecurityMode.NONE, publisher_ids: PublisherIds | None = None) -> None:
        self.now = 100.0
        self.counters = Counters()
        self.publisher = Publisher(1, PubSubTiming(), self.counters, Codec(), BROKERED)
        groups = [] if mode is SecurityMode.NONE else [telemetry_group(1), command_group(1)]
        self.envelope: Envelope = envelope(1, *groups, mode=mode, publisher_ids=publisher_ids)
        self.core = MqttCore(
            Party(
                publisher_id=1,
                seal=self.envelope.seal,
                token=self.envelope.sending_token,
                is_secured=mode is not SecurityMode.NONE,
                names_of=self.publisher.names_of,
                receive_kept=lambda _datagram, _sender: None,
                setpoint_groups=(77,),
            ),
            TopicTree(publisher_ids=publisher_ids),
            Outbox(),
        )

    def send(self, datagrams: list[bytes], address: tuple[str, int] | None = None) -> None:
        for datagram in datagrams:
            for part in self.envelope.seal(datagram, self.now):
                self.core.send(part, datagram, address, self.now, WALL)

    def taken(self) -> list[Outgoing]:
        """What goes to the broker now, and is acknowledged."""
        sent = list(self.core.take(self.now))
        for each in sent:
            self.core.acknowledged(each.parcel)
        return sent

    def begin(self) -> list[Outgoing]:
        self.core.connected(self.now)
        self.send(self.publisher.begin(now=self.now, wall_ticks=WALL))
        self.send(self.publisher.announce(TOPIC, "arm", FIELDS, now=self.now, wall_ticks=WALL))
        self.now += 1.0
        self.send(self.publisher.poll(self.now, WALL))
        return self.taken()
