"""A value is never shown as fresher than it is: maximum ages from the robot's message to the server's node."""

from __future__ import annotations

from typing import Any

import pytest

from tests.unit.bridge.test_core import START_NS, WALL, Bridge
from tests.unit.fleet.fleet_of import Fleet, values
from ua_fleet.bridge.driver import SourceFound, SourceLost, SourceRead
from ua_fleet.bridge.freshness import Freshness, Rhythm
from ua_fleet.counters import Counters
from ua_fleet.pubsub import PubSubTiming, Subscriber, SubscriberEvent
from ua_fleet.pubsub.metadata import make_field, max_age_s
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import Codec

TOPIC = Topic(2, 2, 1005)
"""`count` of the rover in `fleet_of`."""
FIELDS = (make_field("count", BuiltinType.INT32, properties={"RosType": "std_msgs/Int32"}),)
OLD = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)
GONE = int(StatusCode.BAD_NO_COMMUNICATION)


def found(*, may_have_period: bool = True) -> SourceFound:
    return SourceFound(TOPIC, TOPIC.name, FIELDS, may_have_period)


class Line:
    """A robot, its bridge in space 2, the server's side, and another bridge; one clock."""

    def __init__(self, max_ages: dict[Topic, float] | None = None) -> None:
        self.bridge = Bridge(2)
        self.bridge.core.freshness = Freshness(max_ages or {})
        self.other = Bridge(3)
        self.subscriber = Subscriber(0, PubSubTiming(), Counters(), Codec())
        self.fleet = Fleet()
        self.now = 0.0
        self.shown: tuple[Any, int] = (None, 0)
        self.history: list[tuple[float, int]] = []
        self.max_age_ms: float | None = None
        self.is_cut = False

    def find(self, **more: bool) -> None:
        self.bridge.core.from_space(found(**more), now=self.now, wall_ticks=WALL)
        self.carry()

    def say(self, value: int) -> None:
        self.bridge.read(TOPIC, value, ns=round(self.now * 1e9), now=self.now)
        self.carry()

    def read_again(self) -> None:
        event = SourceRead(TOPIC, START_NS + round(self.now * 1e9))
        self.bridge.core.from_space(event, now=self.now, wall_ticks=WALL)
        self.carry()

    def carry(self) -> None:
        sent = self.bridge.take()
        if self.is_cut:
            sent = []
        self.other.hear(sent, self.now)
        self.other.core.poll(self.now)
        events = [event for datagram in sent for event in self.subscriber.receive(datagram, self.now)]
        for event in [*events, *self.subscriber.poll(self.now)]:
            for change in self.fleet.state.apply(event, self.fleet.now):
                found_values = values([change])
                if 1005 in found_values:
                    self.shown = found_values[1005][:2]
                    self.history.append((round(self.now, 3), self.shown[1]))
                if "MaxAge.1005" in found_values:
                    self.max_age_ms = found_values["MaxAge.1005"][0]

    def run(self, duration_s: float) -> None:
        end = self.now + duration_s
        while self.now < end:
            self.now = min(end, self.now + 0.05)
            self.bridge.core.poll(self.now)
            self.carry()


def test_a_value_is_good_for_its_maximum_age_and_then_uncertain() -> None:
    line = Line({TOPIC: 10.0})
    line.find()
    line.say(7)
    assert line.max_age_ms == 10_000.0
    line.run(9.9)
    assert line.shown == (7, 0)
    line.run(0.3)
    assert line.shown == (7, OLD), "its publisher is alive, and has said nothing"
    line.run(100.0)
    assert line.shown == (7, OLD)
    line.say(8)
    assert line.shown == (8, 0)


def test_a_source_without_a_maximum_age_is_good_as_long_as_it_lives() -> None:
    line = Line()
    line.find(may_have_period=False)
    line.say(7)
    line.run(500.0)
    assert line.shown == (7, 0)
    assert line.history == [(0.0, 0)]
    assert line.max_age_ms is None


def test_a_topic_that_came_with_a_period_gets_ten_of_them() -> None:
    line = Line()
    line.find()
    for value in range(25):
        line.say(value)
        line.run(1.0)
    assert line.max_age_ms == pytest.approx(10_000, rel=0.01)
    assert {status for _, status in line.history} == {0}
    line.run(8.0)
    assert line.shown == (24, 0)
    line.run(1.5)
    assert line.shown == (24, OLD)
    assert [message.values for _, _, message in line.other.published] == [(value,) for value in range(25)], "once each"


def test_a_fast_topic_has_three_seconds() -> None:
    line = Line()
    line.find()
    for value in range(25):
        line.say(value)
        line.run(0.05)
    assert line.max_age_ms == 3000.0
    line.run(2.8)
    assert line.shown == (24, 0)
    line.run(0.3)
    assert line.shown == (24, OLD)


def test_a_latched_topic_and_one_without_a_period_have_no_maximum_age() -> None:
    for may_have_period, waits in ((False, [1.0]), (True, [0.2, 3.0, 0.1, 6.0, 0.5])):
        line = Line()
        line.find(may_have_period=may_have_period)
        for value in range(60):
            line.say(value)
            line.run(waits[value % len(waits)])
        line.run(300.0)
        assert line.shown == (59, 0)
        assert line.max_age_ms is None


def test_a_server_that_comes_late_never_sees_the_old_value_as_good() -> None:
    line = Line({TOPIC: 5.0})
    line.find()
    line.say(7)
    line.run(60.0)
    line.fleet, line.history = Fleet(), []
    line.subscriber = Subscriber(0, PubSubTiming(), Counters(), Codec())
    line.other = Bridge(3)
    line.run(65.0)  # until the metadata is announced again
    assert line.shown == (7, OLD)
    assert {status for _, status in line.history if status >> 31 == 0} == {OLD}
    assert line.other.published == [], "another space has no way to say that it is old"


@pytest.mark.parametrize("age_s", [0.2, 0.5, 2.0, 10.0])
def test_the_server_decides_by_itself_when_the_bridge_is_gone(age_s: float) -> None:
    line = Line({TOPIC: age_s})
    line.find()
    line.say(7)
    line.run(age_s * 0.9)
    cut_at = line.now
    line.is_cut = True
    line.run(20.0)
    assert line.shown == (7, GONE)
    ended = next(at for at, status in line.history if status)
    assert ended <= cut_at + min(age_s, 3.0) + 0.1


def test_a_polled_source_is_attested_by_each_reading_that_brings_the_same() -> None:
    line = Line({TOPIC: 1.0})
    line.find(may_have_period=False)
    line.say(7)
    for _ in range(200):
        line.run(0.5)
        line.read_again()
    assert line.history == [(0.0, 0)]
    line.run(1.2)
    assert line.shown == (7, OLD), "it is not read any more"
    line.read_again()
    assert line.shown == (7, 0)
    assert len(line.other.published) <= 2


def test_what_this_bridge_has_never_heard_it_does_not_attest() -> None:
    line = Line()
    line.find()
    line.say(7)
    line.bridge = Bridge(2)  # killed and started anew
    line.run(1.0)
    line.bridge.core.from_space(found(), now=line.now, wall_ticks=WALL + 10_000_000)
    line.carry()
    line.run(60.0)
    assert line.shown == (7, OLD)
    assert line.fleet.state.is_alive(TOPIC)


def test_a_robot_that_was_away_keeps_the_period_that_was_learned() -> None:
    ages = Freshness({})
    ages.found(found())
    for number in range(30):
        ages.told(TOPIC, START_NS + number * 10**9, 0, float(number))
    ages.lost(TOPIC)
    assert ages.take_stale(1000.0) == [], "what is gone is Bad"
    assert ages.found(found()) == pytest.approx(10.0)
    assert ages.take_stale(2000.0) == [], "nothing was read of it since"
    ages.told(TOPIC, START_NS, 0, 2000.0)
    assert ages.take_stale(2009.0) == []
    assert ages.take_stale(2010.5) == [TOPIC]


def test_another_period_is_learned_and_an_interruption_is_none() -> None:
    ages = Freshness({})
    ages.found(found())
    at = 0.0
    told: list[float | None] = []
    for wait in [1.0] * 25 + [500.0] + [1.0] * 60 + [20.0] * 45:
        at += wait
        if (again := ages.told(TOPIC, START_NS + round(at * 1e9), 0, at)) is not None:
            told.append(ages.found(again))
    assert told == pytest.approx([10.0, 200.0])


def test_a_clock_that_was_set_back_begins_the_period_anew() -> None:
    rhythm = Rhythm()
    assert [rhythm.take(number * 10**9) for number in range(20)] == [None] * 20
    assert rhythm.take(0) is None
    taken = [rhythm.take(number * 10**9) for number in range(1, 21)]
    assert taken == [None] * 19 + [1.0]


def test_metadata_says_the_maximum_age_without_a_new_layout() -> None:
    bridge = Bridge(2)
    bridge.core.from_space(found(), now=0.0, wall_ticks=WALL)
    before = bridge.core._publisher.metadata(TOPIC)  # pyright: ignore[reportPrivateUsage]
    for number in range(25):
        bridge.read(TOPIC, number, ns=number * 10**9, now=float(number))
    after = bridge.core._publisher.metadata(TOPIC)  # pyright: ignore[reportPrivateUsage]
    assert before is not None
    assert after is not None
    assert max_age_s(before.fields) is None
    assert max_age_s(after.fields) == pytest.approx(10.0)
    assert before.configuration_version.major == after.configuration_version.major
    assert before.configuration_version.minor < after.configuration_version.minor


def test_a_publisher_that_knows_no_maximum_age_is_attested_by_its_data_alone() -> None:
    """A foreign one: its keep-alives say that it lives, not that anything was read."""
    foreign, said = Bridge(2), list[tuple[float, SubscriberEvent]]()
    subscriber = Subscriber(0, PubSubTiming(), Counters(), Codec(), max_ages={TOPIC: 10.0})
    foreign.core.from_space(found(may_have_period=False), now=0.0, wall_ticks=WALL)
    foreign.read(TOPIC, 7)
    now = 0.0
    while now < 60.0:
        for datagram in foreign.take():
            said += [(now, event) for event in subscriber.receive(datagram, now)]
        said += [(now, event) for event in subscriber.poll(now)]
        now = round(now + 0.1, 3)
        foreign.core.poll(now)
    names = [(at, type(event).__name__) for at, event in said]
    assert names[:3] == [(0.0, "MetaDataReceived"), (0.0, "SourceAppeared"), (0.0, "DataReceived")]
    assert [name for _, name in names[3:]] == ["SourceStale"]
    assert names[3][0] == pytest.approx(10.0, abs=0.2)
    foreign.take()
    foreign.read(TOPIC, 8, ns=10**10, now=now)
    [datagram] = foreign.take()
    assert [type(event).__name__ for event in subscriber.receive(datagram, now)] == ["SourceReturned", "DataReceived"]


def test_a_lost_source_is_not_stale_but_bad() -> None:
    line = Line({TOPIC: 2.0})
    line.find()
    line.say(7)
    line.bridge.core.from_space(SourceLost(TOPIC), now=line.now, wall_ticks=WALL)
    line.carry()
    line.run(10.0)
    assert [status for _, status in line.history] == [0, GONE]


@pytest.mark.parametrize("age", [True, "10", -1.0, 0.0, float("nan"), float("inf"), (1.0,)])
def test_what_is_no_time_is_no_maximum_age(age: Any) -> None:
    assert max_age_s((make_field("count", BuiltinType.INT32, properties={"MaxAge": age}),)) is None
    assert max_age_s(()) is None
