from __future__ import annotations

from ua_fleet.counters import Counters
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec

TOPIC = Topic(2, 2, 1)
FIELDS = (make_field("data", BuiltinType.DOUBLE),)
TICKS = 10**17


def test_each_ones_repeats_do_not_undo_the_others() -> None:
    timing = PubSubTiming(keep_alive_s=1.0, receive_timeout_s=3.0, repeat_interval_s=2.0)
    bridges = [Publisher(2, timing, Counters(), Codec()) for _ in range(2)]
    subscriber = Subscriber(1, timing, Counters(), Codec())
    received: list[float] = []

    def hear(datagrams: list[bytes], now: float) -> None:
        for datagram in datagrams:
            for event in subscriber.receive(datagram, now):
                if isinstance(event, DataReceived):
                    received.extend(event.message.values)

    for number, bridge in enumerate(bridges):
        hear(bridge.announce(TOPIC, "t", FIELDS, now=0.0, wall_ticks=TICKS), 0.0)
        for step in range(3 - 2 * number):  # so that their sequences differ
            ticks = TICKS + 10 * number + step
            hear(bridge.publish(TOPIC, (float(10 * number + step),), timestamp=ticks, now=0.0), 0.0)
    assert received[-1] == 10.0
    del received[:]
    for tenths in range(1, 600):
        now = tenths / 10
        for bridge in bridges:
            hear(bridge.poll(now), now)
    assert received == []
