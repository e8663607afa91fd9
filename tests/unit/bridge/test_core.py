from __future__ import annotations

from typing import Any

import pytest

from ua_fleet.bridge import (
    NODE_ONLY,
    BridgeCore,
    Dropped,
    Rule,
    SampleRead,
    SourceForgotten,
    SourceFound,
    SourceLost,
)
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import FieldMissing
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.values import BuiltinType, StatusCode, Variant, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData, FieldMetaData, FrameKind, NetworkMessage

TIMING = PubSubTiming()
BAD_LIMITS = int(StatusCode.BAD_ENCODING_LIMITS_EXCEEDED)
WALL = ticks_from_unix_ns(1_700_000_000_000_000_000)
START_NS = 1_700_000_000_000_000_000
DATA = (make_field("data", BuiltinType.DOUBLE, properties={"RosType": "std_msgs/Float64"}),)


def always_forward(side: Side, _origin: int, _own_space: int, _own: bool) -> LoopVerdict:
    return LoopVerdict.TO_SPACE if side is Side.PUBSUB else LoopVerdict.TO_PUBSUB


class Bridge:
    """A core with its parts; keeps what it sends and publishes."""

    def __init__(self, space: int, rule: Rule = loop_verdict) -> None:
        self.sent: list[bytes] = []
        self.published: list[tuple[Topic, DataSetMetaData, DataSetMessage]] = []
        self.can_publish = True
        self.counters = Counters()
        self.core = BridgeCore(
            space,
            Publisher(space, TIMING, self.counters, Codec()),
            Subscriber(space, TIMING, self.counters, Codec(), rule),
            self.counters,
            send=self.sent.append,
            publish=self._publish,
            rule=rule,
        )

    def _publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        if self.can_publish:
            self.published.append((topic, metadata, message))
        return self.can_publish

    def take(self) -> list[bytes]:
        sent, self.sent[:] = list(self.sent), []
        return sent

    def find(self, topic: Topic, fields: tuple[FieldMetaData, ...] = DATA, now: float = 0.0) -> None:
        self.core.from_space(SourceFound(topic, topic.name, fields), now=now, wall_ticks=WALL)

    def read(self, topic: Topic, *values: Any, ns: int = 0, now: float = 0.0, **rest: Any) -> None:
        sample = SampleRead(topic, values, START_NS + ns, **rest)
        self.core.from_space(sample, now=now, wall_ticks=WALL)

    def hear(self, datagrams: list[bytes], now: float = 0.0) -> None:
        for datagram in datagrams:
            self.core.from_pubsub(datagram, now=now)

    def values(self) -> list[tuple[Any, ...]]:
        return [message.values for _, _, message in self.published]


TOPIC = Topic(1, 2, 1001)


def data_of(datagrams: list[bytes]) -> list[DataSetMessage]:
    """The key frames in datagrams."""
    decoded = [Codec().decode(datagram) for datagram in datagrams]
    messages = [part for message in decoded if isinstance(message, NetworkMessage) for part in message.messages]
    return [message for message in messages if message.kind == FrameKind.KEY]


def test_sample_of_one_space_is_published_into_the_other() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 1.5, ns=700)
    two.hear(one.take())
    ((topic, metadata, message),) = two.published
    assert (topic, message.values, message.timestamp) == (TOPIC, (1.5,), WALL + 7)
    assert metadata.fields[0].name == "data"
    assert one.counters.from_space == two.counters.to_space == 1
    assert two.counters.looped == 0


def test_own_multicast_is_dropped_as_a_loop() -> None:
    bridge = Bridge(1)
    bridge.find(TOPIC)
    bridge.read(TOPIC, 1.0)
    bridge.hear(bridge.take())
    assert bridge.published == []
    assert bridge.counters.drops[Drop.LOOP] > 0
    assert bridge.counters.looped == 0


def test_own_multicast_is_a_looped_delivery_when_the_rule_is_off() -> None:
    bridge = Bridge(1, always_forward)
    bridge.find(TOPIC)
    bridge.read(TOPIC, 1.0)
    bridge.read(TOPIC, 2.0, ns=100)
    bridge.hear(bridge.take())
    assert bridge.values() == [(1.0,), (2.0,)]
    assert bridge.counters.looped == 2


@pytest.mark.parametrize(
    ("sample", "cause"),
    [
        (SampleRead(Topic(3, 2, 1), (1.0,), 0), Drop.FOREIGN),
        (SampleRead(Topic(0, 2, 1), (1.0,), 0), Drop.FOREIGN),
        (SampleRead(TOPIC, (1.0,), 0, own_publication=True), Drop.OWN_PUBLICATION),
        (SampleRead(Topic(1, 2, 9), (1.0,), 0), Drop.NO_METADATA),
        (SampleRead(TOPIC, ("text",), 0), Drop.CONVERSION),
        (SampleRead(TOPIC, (1.0, 2.0), 0), Drop.CONVERSION),
    ],
)
def test_sample_that_is_not_sent_on_is_counted_by_its_cause(sample: SampleRead, cause: Drop) -> None:
    bridge = Bridge(1)
    bridge.find(TOPIC)
    bridge.take()
    bridge.core.from_space(sample, now=0.0, wall_ticks=WALL)
    assert bridge.take() == []
    assert bridge.counters.drops == {cause: 1}
    assert bridge.counters.from_space == 1


TEXT = (make_field("data", BuiltinType.STRING, properties={"RosType": "std_msgs/String"}),)


def test_a_message_that_is_too_large_makes_what_was_sent_before_not_of_now() -> None:
    """Once, since it may be said often; a message that is dropped is no sign of life."""
    bridge = Bridge(1)
    bridge.find(TOPIC, TEXT)
    bridge.read(TOPIC, "short")
    told: list[Dropped] = []
    bridge.core.dropped = told.append
    bridge.take()
    for number in (1, 2):
        bridge.read(TOPIC, "x" * 70_000, ns=100 * number, now=float(number))
    (said,) = data_of(bridge.take())
    assert (said.values, said.status, said.timestamp) == (("short",), BAD_LIMITS, WALL + 1)
    assert [one.cause for one in told] == [Drop.CONVERSION] * 2
    assert "the largest message may have 65507" in told[0].detail
    bridge.read(TOPIC, "shorter", ns=300, now=3.0)
    (said,) = data_of(bridge.take())
    assert (said.values, said.status) == (("shorter",), 0)
    bridge.read(TOPIC, "x" * 70_000, ns=400, now=4.0)
    (said,) = data_of(bridge.take())
    assert said.status == BAD_LIMITS, "said again"


def test_a_source_whose_first_message_is_too_large_says_nothing() -> None:
    bridge = Bridge(1)
    bridge.find(TOPIC, TEXT)
    bridge.take()
    bridge.read(TOPIC, "x" * 70_000)
    assert bridge.take() == []
    assert bridge.counters.drops == {Drop.CONVERSION: 1}


def test_source_of_another_space_is_not_announced() -> None:
    bridge = Bridge(1)
    bridge.find(Topic(2, 2, 1001))
    assert bridge.take() == []


def test_drops_of_the_driver_are_counted() -> None:
    bridge = Bridge(1)
    bridge.core.from_space(Dropped(Drop.TYPE_MISSING, 3, "p/T"), now=0.0, wall_ticks=WALL)
    assert bridge.counters.drops == {Drop.TYPE_MISSING: 3}


def test_timestamps_strictly_increase_also_when_the_robots_clock_does_not() -> None:
    bridge = Bridge(1)
    bridge.find(TOPIC)
    for ns in (500, 500, 0, 1000):
        bridge.read(TOPIC, 1.0, ns=ns)
    assert [message.timestamp for message in data_of(bridge.take())] == [WALL + 5, WALL + 6, WALL + 7, WALL + 10]


def test_repeat_and_duplicate_are_published_once() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 1.0)
    sent = one.take()
    two.hear(sent)
    two.hear(sent)
    one.core.poll(TIMING.repeat_interval_s)
    two.hear(one.take(), now=TIMING.repeat_interval_s)
    assert two.values() == [(1.0,)]
    assert two.counters.drops[Drop.DUPLICATE] >= 1
    assert two.counters.drops[Drop.REPEATED] >= 1


def test_lost_source_says_so_once_and_nothing_of_it_goes_into_a_space() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 1.0, ns=10_000_000_000)
    two.hear(one.take())
    one.core.from_space(SourceLost(TOPIC), now=1.0, wall_ticks=WALL)
    lost = one.take()
    (message,) = data_of(lost)
    assert message.status == StatusCode.BAD_NO_COMMUNICATION
    assert message.timestamp == WALL + 100_000_001
    two.hear(lost, now=1.0)
    assert two.values() == [(1.0,)]
    assert not [drop for drop in two.counters.drops if drop not in (Drop.LOOP, Drop.REPEATED)]
    one.core.poll(100.0)
    assert one.take() == []
    one.find(TOPIC, now=101.0)
    one.read(TOPIC, 2.0, now=101.0)
    two.hear(one.take(), now=101.0)
    assert two.values() == [(1.0,), (2.0,)]
    assert two.counters.looped == 0


def test_forgotten_source_is_said_no_more_and_its_numbers_go_on() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 1.0)
    two.hear(one.take())
    one.core.from_space(SourceLost(TOPIC), now=1.0, wall_ticks=WALL)
    one.core.from_space(SourceForgotten(TOPIC), now=2.0, wall_ticks=WALL)
    one.take()
    one.read(TOPIC, 2.0)
    assert one.counters.drops[Drop.NO_METADATA] == 1
    one.core.poll(TIMING.announce_interval_s + 3.0, WALL)
    assert data_of(one.take()) == []
    one.find(TOPIC, now=40.0)
    one.read(TOPIC, 3.0, now=40.0)
    two.hear(one.take(), now=40.0)
    assert two.values() == [(1.0,), (3.0,)]


def test_bad_message_is_not_published_into_the_space() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 1.0, status=StatusCode.BAD_SENSOR_FAILURE)
    one.read(TOPIC, 2.0, ns=100, status=StatusCode.UNCERTAIN)
    two.hear(one.take())
    assert two.values() == [(2.0,)]
    assert two.counters.to_space == 1


def test_bad_field_travels_as_its_status_code_and_goes_into_no_space() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_OUT_OF_RANGE))
    sent = one.take()
    (message,) = data_of(sent)
    assert (message.types, message.values) == ((BuiltinType.STATUS_CODE,), (StatusCode.BAD_OUT_OF_RANGE,))
    two.hear(sent)
    assert two.published == []
    assert two.counters.drops[Drop.CONVERSION] == 1


def test_message_that_the_driver_cannot_publish_is_no_delivery() -> None:
    one, two = Bridge(1), Bridge(2)
    two.can_publish = False
    one.find(TOPIC)
    one.read(TOPIC, 1.0)
    two.hear(one.take())
    assert two.counters.to_space == two.counters.looped == 0


def test_data_for_nodes_alone_goes_into_no_space() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC, (make_field("Name", BuiltinType.STRING, properties={NODE_ONLY: True}),))
    one.read(TOPIC, "ros1")
    two.hear(one.take())
    assert two.published == []
    assert not [drop for drop in two.counters.drops if drop != Drop.LOOP]
    one.find(TOPIC)
    one.read(TOPIC, 1.0, ns=100)
    two.hear(one.take())
    assert two.values() == [(1.0,)]


def test_late_bridge_probes_and_gets_the_latched_value() -> None:
    one, late = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 1.0)
    one.take()
    now = 0.0
    for _ in range(200):
        deadlines = [d for d in (one.core.next_deadline(), late.core.next_deadline()) if d is not None]
        now = max(now, min(deadlines))
        for here, there in ((one, late), (late, one)):
            here.core.poll(now)
            there.hear(here.take(), now)
        if late.published:
            break
    assert late.values() == [(1.0,)]
    assert now < 2 * TIMING.repeat_interval_s


def test_next_deadline_is_the_earlier_of_both_sides() -> None:
    one, two = Bridge(1), Bridge(2)
    assert one.core.next_deadline() is None
    one.find(TOPIC)
    assert one.core.next_deadline() == pytest.approx(TIMING.keep_alive_s)
    two.hear(one.take())
    assert two.core.next_deadline() == pytest.approx(TIMING.receive_timeout_s)


def test_clock_of_a_source_that_is_set_back_is_no_loop() -> None:
    one, two = Bridge(1), Bridge(2)
    one.find(TOPIC)
    one.read(TOPIC, 0.0, ns=3_600_000_000_000)
    two.hear(one.take())
    again = Bridge(1)  # restarted, with the clock an hour back
    for second in range(10):
        now = 1.0 + second
        if second == 0:
            again.find(TOPIC, now=now)
        again.read(TOPIC, float(second), ns=second * 1_000_000_000, now=now)
        two.hear(again.take(), now)
    assert two.values()[-1] == (9.0,)
    assert two.counters.looped == 0


def test_whoever_answers_for_others_is_told_when_their_values_are_not_of_now() -> None:
    robot, other = Bridge(1), Bridge(2)
    told: list[tuple[Topic, bool]] = []
    other.core.stale = lambda topic, is_stale: told.append((topic, is_stale))
    robot.find(TOPIC)
    robot.read(TOPIC, 1.0, ns=1)
    other.hear(robot.take())
    assert other.values() == [(1.0,)]
    assert told == []
    silent = TIMING.receive_timeout_s + 1
    other.core.poll(silent)
    robot.core.poll(silent)
    other.hear(robot.take(), now=silent)
    assert told == [(TOPIC, True), (TOPIC, False)]
    robot.core.from_space(SourceLost(TOPIC), now=silent, wall_ticks=WALL)
    other.hear(robot.take(), now=silent)
    assert told[2:] == [(TOPIC, True)]
    other.core.poll(2 * silent + 1)
    robot.core.poll(2 * silent + 1)
    other.hear(robot.take(), now=2 * silent + 1)
    assert set(told[2:]) == {(TOPIC, True)}
    assert other.values() == [(1.0,)]


def test_a_message_without_a_field_is_counted_and_told_and_the_next_one_goes_on() -> None:
    bridge, told = Bridge(1), list[Dropped]()
    bridge.core.dropped = told.append
    whole = bridge.core._publish  # pyright: ignore[reportPrivateUsage]

    def publish(topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        if message.values == (666.0,):
            raise FieldMissing("rover.goal: its messages have no field 'y'")
        if message.values == (777.0,):
            raise ValueError("a mistake of the driver")
        return whole(topic, metadata, message)

    bridge.core._publish = publish  # pyright: ignore[reportPrivateUsage]
    caught: list[str] = []
    bridge.core.caught = lambda loop, error: caught.append(f"{loop}: {error}")
    other = Bridge(2)
    source = Topic(2, 2, 5)
    other.core.from_space(SourceFound(source, "five", DATA), now=0.0, wall_ticks=WALL)
    for number, value in enumerate((666.0, 777.0, 1.0)):
        other.core.from_space(SampleRead(source, (value,), START_NS + number, 0, False), now=0.0, wall_ticks=WALL)
    for datagram in other.take():
        bridge.core.from_pubsub(datagram, now=0.0)
    assert [message.values for _, _, message in bridge.published] == [(1.0,)]
    assert told == [Dropped(Drop.CONVERSION, detail="rover.goal: its messages have no field 'y'")]
    assert caught == ["messages: a mistake of the driver"]
