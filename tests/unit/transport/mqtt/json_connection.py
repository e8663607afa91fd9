"""Two processes over a broker that is not there: what one has sent as JSON, the other hears."""

from __future__ import annotations

import json
from typing import Any

from tests.unit.pubsub.publishing import FIELDS, TOPIC, WALL
from ua_fleet.counters import Counters
from ua_fleet.pubsub import Application, Publisher, PubSubTiming, Subscriber, SubscriberEvent, describe
from ua_fleet.transport.mqtt.core import MqttCore, Outgoing
from ua_fleet.transport.mqtt.json import JsonSettings
from ua_fleet.transport.mqtt.outbox import Outbox
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.transport.party import Party
from ua_fleet.wire import Codec
from ua_fleet.wire.json import Form

METADATA = "opcua/json/metadata/1/group-2/arm"
QUEUE = TOPIC.name


class Process:
    """A publisher and a subscriber of one space."""

    def __init__(self, space: int, *, form: Form = Form.VERBOSE, has_actions: bool = True, **settings: Any) -> None:
        self.now = 100.0
        self.space, self.counters = space, Counters()
        application = Application(describe("urn:test", f"space {space}"), is_brokered=True, json_form=form)
        self.publisher = Publisher(space, PubSubTiming(), self.counters, Codec(), application)
        self.subscriber = Subscriber(space, PubSubTiming(), self.counters, Codec())
        tree = TopicTree(is_json=True, has_actions=has_actions)
        party = Party(
            publisher_id=space,
            seal=lambda plain, _now: [plain],
            token=lambda _now: 0,
            is_secured=False,
            names_of=self.publisher.names_of,
            receive_kept=lambda _datagram, _sender: None,
            setpoint_groups=(77,),
        )
        self.core = MqttCore(party, tree, Outbox(), json=JsonSettings(form=form, has_actions=has_actions, **settings))
        self.core.connected(self.now)

    def send(self, datagrams: list[bytes], address: tuple[str, int] | None = None) -> list[Outgoing]:
        """Say something; what goes to the broker."""
        for datagram in datagrams:
            self.core.send(datagram, datagram, address, self.now, WALL)
        return self.taken()

    def taken(self) -> list[Outgoing]:
        sent = list(self.core.take(self.now))
        for each in sent:
            self.core.acknowledged(each.parcel)
        return sent

    def begin(self) -> list[Outgoing]:
        """Announce all there is: one source."""
        sent = self.send(self.publisher.begin(now=self.now, wall_ticks=WALL))
        sent += self.send(self.publisher.announce(TOPIC, "arm", FIELDS, now=self.now, wall_ticks=WALL))
        self.now += 1.0
        return sent + self.send(self.publisher.poll(self.now, WALL))

    def publish(self, level: float, name: str = "a", *, later: int = 0) -> list[Outgoing]:
        values = (level, name)
        return self.send(self.publisher.publish(TOPIC, values, timestamp=WALL + later, now=self.now))

    def hear(self, topic: str, payload: bytes | Any, *, is_retained: bool = False) -> list[SubscriberEvent]:
        """Take a message of the broker; something else than bytes is what its JSON says."""
        text = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        return self._take(self.core.received(topic, text, self.now, is_retained=is_retained))

    def hear_all(self, sent: list[Outgoing]) -> list[SubscriberEvent]:
        return [event for each in sent for event in self.hear(each.topic, each.payload)]

    def wait(self, seconds: float) -> list[SubscriberEvent]:
        """Time passes."""
        self.now += seconds
        self.core.poll(self.now)
        return self._take(self.core.late(self.now))

    def _take(self, found: list[Any]) -> list[SubscriberEvent]:
        events: list[SubscriberEvent] = []
        for datagram, is_fresh in found:
            events += self.subscriber.receive(datagram, self.now, ("topic", 0), is_fresh=is_fresh)
        return events
