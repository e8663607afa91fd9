"""Messages that are larger than a datagram, from a publisher to a subscriber."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, only
from tests.unit.pubsub.security.securing import envelope
from ua_fleet.counters import Counters
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub import DataReceived, Publisher, PubSubTiming, Subscriber, SubscriberEvent, make_field
from ua_fleet.pubsub.application import PRODUCT_URI, Application, describe
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import SecurityMode

LARGEST = 1024 * 1024
APPLICATION = Application(describe(PRODUCT_URI, "publisher"), max_message_bytes=LARGEST)


@pytest.mark.parametrize("mode", SecurityMode)
def test_a_large_value_and_large_metadata_arrive(mode: SecurityMode) -> None:
    publisher = Publisher(1, PubSubTiming(), Counters(), CODEC, APPLICATION)
    fields = (make_field("map", BuiltinType.STRING, properties={"RosDefinition": "d" * 70_000}),)
    secured = () if mode is SecurityMode.NONE else ("t-1",)
    sealing = envelope(1, *secured, mode=mode, max_datagram_bytes=1400)
    counters = Counters()
    reading = Subscriber(0, PubSubTiming(), counters, CODEC, envelope=envelope(0, *secured, mode=mode))
    events: list[SubscriberEvent] = []
    for plain in (
        *publisher.announce(TOPIC, "map", fields, now=0.0, wall_ticks=WALL),
        *publisher.publish(TOPIC, ("m" * 500_000,), timestamp=WALL, now=0.0),
    ):
        sealed = sealing.seal(plain, 0.0)
        assert max(map(len, sealed)) <= 1400
        for datagram in sealed:
            events += reading.receive(datagram, 0.0)
    [data] = only(DataReceived, events)
    assert data.message.values == ("m" * 500_000,)
    assert data.metadata.fields == fields
    assert counters.drops == {}
    with pytest.raises(LocalWireError, match="the largest message may have 1048576"):
        publisher.publish(TOPIC, ("m" * LARGEST,), timestamp=WALL, now=0.0)


def test_messages_share_a_datagram_only_as_far_as_it_goes() -> None:
    """A NetworkMessage of several DataSetMessages cannot be sent as chunks."""
    sealing = envelope(1, "t-1", max_datagram_bytes=576)
    publisher = Publisher(1, PubSubTiming(), Counters(), CODEC, max_packed_bytes=sealing.max_plain_bytes)
    for number in range(50):
        publisher.announce(Topic(1, 2, 1001 + number), "arm", FIELDS, now=0.0, wall_ticks=WALL)
        publisher.publish(Topic(1, 2, 1001 + number), (1.0, "a" * 30), timestamp=WALL, now=0.0)
    sent = publisher.poll(5.0)
    assert len(sent) > 1
    for plain in sent:
        [sealed] = sealing.seal(plain, 5.0)
        assert len(sealed) <= 576
