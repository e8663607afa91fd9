from __future__ import annotations

from collections.abc import Sequence

from structlog.testing import capture_logs
from ua_bridges.ros2.graph import GraphWatch, Publisher, PublishersChanged
from ua_bridges.ros2.qos import Offer
from ua_bridges.ros2.sources import FORGET_S, MOST_GONE, Sources

from ua_fleet.bridge.driver import DriverEvent, Dropped, SourceForgotten
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

ROBOT = Publisher("std_msgs/msg/Int32", Offer(b"1", reliable=True, transient_local=False), own=False)
HOSTILE, HONEST = "/ua_5_2_66", "/ua_5_2_7"


class Source:
    def __init__(self, name: str, bench: Bench) -> None:
        self.name, self._bench = name, bench
        self.offence: str | None = None
        self.followed: list[int] = []
        self.is_closed = False

    def follow(self, publishers: Sequence[Publisher]) -> None:
        self._bench.now += self._bench.follow_takes_s
        if self.name in self._bench.failing:
            raise RuntimeError("create_subscription failed\nfor a reason")
        self.followed.append(len(publishers))

    def looked(self) -> None:
        pass

    def close(self) -> None:
        self.is_closed = True
        if self.name in self._bench.failing:
            raise KeyError("close")


class Bench:
    def __init__(self, *fixed: str) -> None:
        self.now, self.follow_takes_s = 0.0, 0.0
        self.failing: set[str] = set()
        self.made: list[Source] = []
        self.events: list[DriverEvent] = []
        self.graph = GraphWatch(5, fixed)
        self.offenders = Offenders(self)
        self.sources = Sources(fixed, self._make, self.graph, self, self.offenders, lambda: self.now)
        self.sources.open()

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)

    def _make(self, name: str) -> Source:
        self.made.append(Source(name, self))
        return self.made[-1]

    def change(self, name: str, *publishers: Publisher) -> None:
        self.sources.changed(PublishersChanged(name, publishers))

    def of(self, name: str) -> Source:
        return next(source for source in reversed(self.made) if source.name == name)


def test_a_topic_that_makes_the_bridge_fail_is_put_aside_and_the_others_go_on() -> None:
    bench = Bench()
    bench.failing.add(HOSTILE)
    bench.change(HOSTILE, ROBOT)
    bench.change(HONEST, ROBOT)
    with capture_logs() as logs:
        bench.sources.look()
    assert [entry["log_level"] for entry in logs] == ["error", "error"]  # following it, and closing it
    assert bench.of(HONEST).followed == [1]
    assert bench.events == [Dropped(Drop.MISBEHAVED)]
    assert bench.offenders.told(0.0)[HOSTILE].startswith(
        "the bridge cannot follow it: create_subscription failed for a"
    )


def test_it_is_followed_again_when_its_time_is_over() -> None:
    bench = Bench("/battery")
    bench.failing.add("/battery")
    bench.change("/battery", ROBOT)
    bench.sources.look()
    first = bench.made[0]
    assert first.is_closed
    bench.change("/battery", ROBOT)
    bench.sources.look()
    assert len(bench.made) == 2
    assert bench.of("/battery").followed == []
    bench.failing.clear()
    bench.now = 1.5
    bench.sources.look()  # asks the graph to tell its publishers again
    bench.change("/battery", ROBOT)
    bench.sources.look()
    assert bench.of("/battery").followed == [1]


def test_a_source_that_tells_of_an_offence_is_put_aside() -> None:
    bench = Bench()
    bench.change(HOSTILE, ROBOT)
    bench.sources.look()
    bench.of(HOSTILE).offence = "10 messages in a row could not be read"
    bench.sources.look()
    assert bench.of(HOSTILE).is_closed
    assert bench.offenders.told(0.0) == {HOSTILE: "10 messages in a row could not be read"}


def test_many_new_topics_are_followed_a_few_at_a_time_and_known_ones_first() -> None:
    bench = Bench()
    bench.change(HONEST, ROBOT)
    bench.sources.look()
    bench.follow_takes_s = 0.004
    for number in range(1000, 1500):
        bench.change(f"/ua_5_2_{number}", ROBOT)
    bench.change(HONEST)
    before = bench.now
    assert bench.sources.look()
    assert bench.now - before < 0.03
    assert bench.of(HONEST).followed == [1, 0]
    looks = 1
    while bench.sources.look():
        looks += 1
    assert len(bench.made) == 501
    assert looks > 100


def test_topics_that_are_gone_are_forgotten_and_configured_ones_never() -> None:
    bench = Bench("/battery")
    for name in ("/battery", HONEST):
        bench.change(name, ROBOT)
        bench.sources.look()
        bench.change(name)
        bench.sources.look()
    bench.now = FORGET_S - 1
    bench.sources.look()
    assert not bench.of(HONEST).is_closed
    bench.now = FORGET_S + 1
    bench.sources.look()
    assert bench.of(HONEST).is_closed
    assert bench.events == [SourceForgotten(Topic(5, 2, 7))]
    assert not bench.of("/battery").is_closed


def test_a_topic_that_returns_is_not_forgotten_and_many_that_are_gone_are_not_kept() -> None:
    bench = Bench()
    bench.change(HONEST, ROBOT)
    bench.sources.look()
    bench.change(HONEST)
    bench.sources.look()
    bench.change(HONEST, ROBOT)
    bench.sources.look()
    for number in range(1000, 1000 + 2 * MOST_GONE):
        bench.change(f"/ua_5_2_{number}", ROBOT)
        bench.sources.look()
        bench.change(f"/ua_5_2_{number}")
        bench.sources.look()
    assert len(bench.events) == MOST_GONE
    bench.now = 2 * FORGET_S
    bench.sources.look()
    assert len(bench.events) == 2 * MOST_GONE
    assert not bench.of(HONEST).is_closed


def test_a_topic_whose_publishers_leave_while_it_is_put_aside_is_forgotten() -> None:
    bench = Bench("/battery")
    for name in ("/battery", HOSTILE, HONEST):
        bench.change(name, ROBOT)
        bench.sources.look()
        bench.of(name).offence = "10 messages in a row could not be read"
        bench.sources.look()
    bench.change(HOSTILE)
    bench.sources.look()
    bench.now = 2.0
    bench.sources.look()  # their time is over; the graph tells who is there
    bench.change(HONEST, ROBOT)
    bench.sources.look()
    bench.now = 2.0 + FORGET_S
    bench.sources.look()
    assert [event for event in bench.events if isinstance(event, SourceForgotten)] == [SourceForgotten(Topic(5, 2, 66))]
    assert bench.of(HONEST).followed == [1]
