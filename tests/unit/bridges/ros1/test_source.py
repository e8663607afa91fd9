# pyright: basic, reportMissingImports=false, reportCallIssue=false, reportAttributeAccessIssue=false
# (pyright finds the std_msgs of ROS 2)
from __future__ import annotations

import asyncio
import io
import time
from pathlib import Path
from typing import Any, cast

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Header, String
from ua_bridges.ros.feed import Mapped, MappedFeed, MirrorFeed
from ua_bridges.ros.latched import is_latched
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.source import MOST_LINKS, RosSource
from ua_bridges.ros1.tcpros import Broken

from ua_fleet.bridge.driver import DriverEvent, Dropped, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import DataSetConfig, ScalarType
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant

TOPIC = Topic(1, 2, 7)
NAME = "/ua_1_2_7"


class Inlet:
    def __init__(self) -> None:
        self.events: list[DriverEvent] = []

    def put(self, event: DriverEvent) -> None:
        self.events.append(event)

    def take(self) -> list[DriverEvent]:
        events, self.events = self.events, []
        return events


class Link:
    """A link to a publisher, without its sockets."""

    def __init__(self, message_class: Any, callerid: str = "/robot", *, latched: bool = False) -> None:
        self.header = {
            "callerid": callerid,
            "type": message_class._type,
            "md5sum": message_class._md5sum,
            "message_definition": message_class._full_text,
            "latching": "1" if latched else "0",
        }
        self.uri = f"http://{callerid[1:]}:1/"
        self.is_closed = False

    def start(self) -> None:
        pass

    def close(self) -> None:
        self.is_closed = True


def bytes_of(message: Any) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


class Bench:
    def __init__(self, feed: Any = None, folder: Path | None = None) -> None:
        self.inlet, self.memory = Inlet(), LatchMemory(folder)
        self.offenders = Offenders(self.inlet)
        self.up: list[Link] = []
        self.coming: Link | None = None
        self.source = RosSource(
            NAME,
            [feed or MirrorFeed(TOPIC, self.inlet)],
            "/ua_bridge",
            self.inlet,
            self.memory,
            self.offenders,
            lambda *_: cast("Any", self.coming),
        )

    def _add(self, link: Link) -> None:
        self.coming = link
        self.source.connect([link.uri], time.monotonic())
        self.up.append(link)
        self.source.link_up(cast("Any", link))

    def look(self, *links: Link) -> list[DriverEvent]:
        """A look at the links that are up now."""
        for gone in [link for link in self.up if link not in links]:
            self.up.remove(gone)
            self.source.link_ended(cast("Any", gone), None)
        for link in links:
            if link not in self.up:
                self._add(link)
        self.source.check(["/robot"], 0.0)
        return self.inlet.take()

    def hear(self, link: Link, message: Any) -> list[DriverEvent]:
        if link not in self.up:
            self._add(link)
        self.source.link_heard(cast("Any", link), message if isinstance(message, bytes) else bytes_of(message))
        return self.inlet.take()


@pytest.fixture
def bench() -> Bench:
    return Bench()


def kinds(events: list[DriverEvent]) -> list[str]:
    return [type(event).__name__ for event in events]


def test_link_alone_announces_the_source(bench: Bench) -> None:
    (found,) = bench.look(Link(Float64))
    assert isinstance(found, SourceFound)
    assert (found.topic, found.name, [field.name for field in found.fields]) == (TOPIC, "ua_1_2_7", ["data"])
    properties = {key.name: value for key, _, value in found.fields[0].properties}
    assert properties == {"RosType": "std_msgs/Float64", "RosDefinition": "float64 data\n"}


def test_message_before_the_first_look_announces_the_source_first(bench: Bench) -> None:
    link = Link(Float64)
    before = time.time_ns()
    found, sample = bench.hear(link, Float64(1.5))
    assert isinstance(found, SourceFound)
    assert isinstance(sample, SampleRead)
    assert (sample.topic, sample.values, sample.status, sample.own_publication) == (TOPIC, (1.5,), 0, False)
    assert before <= sample.source_time_ns <= time.time_ns()
    assert bench.look(link) == []
    assert kinds(bench.hear(link, Float64(2.5))) == ["SampleRead"]


def test_header_at_the_top_level_gives_the_time(bench: Bench) -> None:
    now = int(time.time())
    link = Link(JointState)
    message = JointState(header=Header(frame_id="base"))
    message.header.stamp.secs, message.header.stamp.nsecs = now, 7
    _, sample = bench.hear(link, message)
    assert isinstance(sample, SampleRead)
    assert sample.source_time_ns == now * 1_000_000_000 + 7
    message.header.stamp.secs = 12  # time since a simulation began
    (sample,) = bench.hear(link, message)
    assert isinstance(sample, SampleRead)
    assert sample.source_time_ns >= now * 1_000_000_000


def test_source_is_lost_at_the_second_look_without_a_link_and_found_again(bench: Bench) -> None:
    link = Link(Float64)
    bench.look(link)
    assert bench.look() == []
    assert bench.look() == [SourceLost(TOPIC)]
    assert bench.look() == []
    again = Link(Float64)
    assert kinds(bench.look(again)) == ["SourceFound"]
    assert kinds(bench.hear(again, Float64(1.0))) == ["SampleRead"]


def test_second_publisher_keeps_the_source_alive(bench: Bench) -> None:
    first, second = Link(Float64, "/a"), Link(Float64, "/b")
    assert kinds(bench.look(first, second)) == ["SourceFound"]
    for _ in range(3):
        assert bench.look(second) == []


def test_publisher_of_another_type_is_a_conflict_until_the_first_has_gone(bench: Bench) -> None:
    first, second = Link(Float64, "/a"), Link(String, "/b")
    bench.hear(first, Float64(1.0))
    assert bench.look(first, second) == []
    text = "/ua_1_2_7: publishers disagree about the type; std_msgs/String of /b is not read"
    assert bench.hear(second, String("x")) == [Dropped(Drop.CONFLICT, detail=text)]
    assert bench.look(second) == []
    assert bench.look(second) == [SourceLost(TOPIC)]
    assert kinds(bench.look(second)) == ["SourceFound"]
    assert kinds(bench.hear(second, String("x"))) == ["SampleRead"]


def test_silent_publisher_gives_way_to_the_first_of_another_type_that_says_something(bench: Bench) -> None:
    silent, other, right = Link(Float64, "/silent"), Link(String, "/other"), Link(String, "/right")
    bench.look(silent)
    assert bench.look(silent, other, right) == [], "a link says nothing"
    with pytest.raises(Broken, match="its first message is no std_msgs/String"):
        bench.hear(other, b"rubbish")
    assert not silent.is_closed
    found, _, sample = bench.hear(right, String("x"))
    assert isinstance(found, SourceFound)
    assert isinstance(sample, SampleRead)
    assert (found.fields[0].builtin_type, sample.values) == (BuiltinType.STRING, ("x",))
    assert (silent.is_closed, other.is_closed, right.is_closed) == (True, False, False)
    assert bench.offenders.told(time.monotonic()) == {
        "/ua_1_2_7 of http://silent:1/": "it says nothing, and its type is std_msgs/Float64; another publisher says "
        "something, as std_msgs/String"
    }
    # When it is tried again it has to wait, whatever it says then.
    silent = Link(Float64, "/silent")
    bench.coming = silent
    bench.source.connect([silent.uri], time.monotonic() + 60)
    bench.source.link_up(cast("Any", silent))
    bench.source.link_heard(cast("Any", silent), bytes_of(Float64(1.0)))
    assert [event.cause for event in bench.inlet.take() if isinstance(event, Dropped)] == [Drop.CONFLICT]
    assert bench.source.is_alive


def charge(kind: ScalarType, max_rate_hz: float | None = None) -> Mapped:
    """Data that is read from a robot's topic `/charge`."""
    mapping = TopicMapping(topic="/charge", type="std_msgs/Float64", max_rate_hz=max_rate_hz)
    return Mapped("arm", "Charge", Topic(1, 2, 9), DataSetConfig(id=9, type=kind, source=mapping), mapping)


async def test_a_mapped_topic_that_is_latched_says_so() -> None:
    bench = Bench()
    bench.source._feeds = [MappedFeed(charge(ScalarType.DOUBLE), bench.inlet, asyncio.get_running_loop())]
    (found,) = bench.look(Link(Float64, latched=True))
    assert isinstance(found, SourceFound)
    assert is_latched(found.fields)
    assert not found.may_have_period


async def test_type_of_a_mapped_topic_is_that_of_the_file_whoever_comes_first() -> None:
    inlet = Inlet()
    bench = Bench(MappedFeed(charge(ScalarType.INT32), inlet, asyncio.get_running_loop()))
    wrong, right = Link(String, "/wrong"), Link(Float64, "/right")
    bench.look(wrong)
    bench.hear(wrong, String("x"))
    bench.look(wrong, right)
    bench.hear(right, Float64(2.0))
    sample = inlet.take()[-1]
    assert isinstance(sample, SampleRead)
    assert sample.values == (2,)
    assert wrong.is_closed
    (reason,) = bench.offenders.told(time.monotonic()).values()
    assert reason == "its type is std_msgs/String; another publisher has std_msgs/Float64, as fleet.yaml says"
    # Silent or not, the right one stays.
    again = Link(String, "/again")
    bench.look(right, again)
    (conflict,) = bench.hear(again, String("y"))
    assert isinstance(conflict, Dropped)
    assert conflict.cause is Drop.CONFLICT


def test_robot_that_comes_back_with_another_type_is_announced_again(bench: Bench) -> None:
    bench.look(Link(Float64))
    changed = Link(String)
    (found,) = bench.look(changed)
    assert isinstance(found, SourceFound)
    assert found.fields[0].builtin_type == BuiltinType.STRING


def test_own_publisher_does_not_make_the_source_alive_and_its_messages_are_marked(bench: Bench) -> None:
    own = Link(Float64, "/ua_bridge")
    assert bench.look(own) == []
    (sample,) = bench.hear(own, Float64(1.0))
    assert isinstance(sample, SampleRead)
    assert sample.own_publication


def test_latched_source_says_so(bench: Bench) -> None:
    (found,) = bench.look(Link(Float64, latched=True))
    assert isinstance(found, SourceFound)
    assert is_latched(found.fields)


def test_type_without_a_class_is_counted_for_each_message(bench: Bench) -> None:
    link = Link(Float64)
    link.header |= {"type": "acme_msgs/Evil", "md5sum": "0" * 32, "message_definition": "int8 X;Y=1"}
    assert bench.look(link) == []
    text = "/ua_1_2_7: 'int8 X;Y=1' is neither a field nor a constant"
    assert bench.hear(link, Float64(1.0)) == [Dropped(Drop.TYPE_MISSING, detail=text)]


def test_bytes_that_are_no_message_are_counted_and_told_once(bench: Bench) -> None:
    link = Link(Float64)
    bench.look(link)
    details = []
    for _ in range(2):
        (dropped,) = bench.hear(link, b"abc")
        assert isinstance(dropped, Dropped)
        assert dropped.cause == Drop.CONVERSION
        details.append(bool(dropped.detail))
    assert details == [True, False]


def test_publisher_of_nothing_but_rubbish_is_put_aside_and_one_that_errs_is_not(bench: Bench) -> None:
    erring, hostile = Link(Float64, "/erring"), Link(Float64, "/hostile")
    bench.look(erring, hostile)
    for _ in range(10):
        for _ in range(9):
            bench.hear(erring, b"abc")
        bench.hear(erring, Float64(1.0))
    for _ in range(9):
        bench.hear(hostile, b"abc")
    with pytest.raises(Broken, match="10 messages in a row are no std_msgs/Float64"):
        bench.hear(hostile, b"abc")
    bench.source.link_ended(cast("Any", hostile), "rubbish")
    assert Dropped(Drop.MISBEHAVED) in bench.inlet.take()
    assert bench.offenders.told(time.monotonic()) == {"/ua_1_2_7 of http://hostile:1/": "rubbish"}
    bench.coming = again = Link(Float64, "/hostile")
    bench.source.connect([again.uri], time.monotonic())
    bench.source.link_up(cast("Any", again))
    assert kinds(bench.hear(erring, Float64(2.0))) == ["SampleRead"]
    bench.source.connect([again.uri], time.monotonic() + 60)
    bench.source.link_up(cast("Any", again))
    bench.source.link_heard(cast("Any", again), bytes_of(Float64(3.0)))
    assert kinds(bench.inlet.take()) == ["SampleRead"]


def test_publisher_that_changes_its_type_all_the_time_is_put_aside(bench: Bench) -> None:
    for _ in range(4):
        bench.look(Link(Float64))
        bench.look(Link(String))
    bench.look(Link(Float64))
    with pytest.raises(Broken, match="changed the type of its topic 8 times"):
        bench.look(Link(String))


def test_type_whose_elements_nothing_bounds_is_not_read(bench: Bench) -> None:
    link = Link(Float64)
    text = "A[] all\n" + "=" * 80 + "\nMSG: acme_msgs/A\n"
    link.header |= {"type": "acme_msgs/Thing", "md5sum": "0" * 32, "message_definition": text}
    (dropped,) = bench.hear(link, b"\xff\xff\xff\xff")
    assert isinstance(dropped, Dropped)
    assert dropped.cause is Drop.TYPE_MISSING
    assert "an array of messages without content" in dropped.detail


def test_links_to_one_topic_are_bounded_and_end_with_it(bench: Bench) -> None:
    links = [Link(Float64, f"/robot{number}") for number in range(MOST_LINKS + 10)]
    made = iter(links)
    bench.source._make_link = lambda *_: cast("Any", next(made))
    bench.source.connect([link.uri for link in links], 0.0)
    assert len(list(made)) == 10
    bench.source.close()
    assert [link.is_closed for link in links] == [True] * MOST_LINKS + [False] * 10


def test_links_that_say_nothing_give_way_to_a_publisher_that_there_is_no_place_for(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    links = [Link(Float64, f"/silent{number}") for number in range(MOST_LINKS - 2)]
    links[3:3] = [talking, once] = [Link(Float64, "/talking"), Link(Float64, "/once")]
    new = [Link(Float64, f"/new{number}") for number in range(MOST_LINKS)]
    made = iter([*links, *new])
    bench.source._make_link = lambda *_: cast("Any", next(made))
    now = 1000.0
    monkeypatch.setattr("ua_bridges.ros1.source.time.monotonic", lambda: now)
    bench.source.connect([link.uri for link in links], now)
    for link in links:
        bench.source.link_up(cast("Any", link))
    for link in (talking, once):
        bench.source.link_heard(cast("Any", link), bytes_of(Float64(1.0)))
    bench.source.connect([new[0].uri], now + 9.0)
    assert not any(link.is_closed for link in links)  # one that has just come may still say something
    now += 11.0
    bench.source.link_heard(cast("Any", talking), bytes_of(Float64(2.0)))
    bench.inlet.take()
    bench.source.connect([new[0].uri], now)
    assert [link for link in links if link.is_closed] == [links[0]]
    bench.source.link_up(cast("Any", new[0]))
    bench.source.link_heard(cast("Any", new[0]), bytes_of(Float64(3.0)))
    dropped, sample = bench.inlet.take()
    assert isinstance(sample, SampleRead)
    assert isinstance(dropped, Dropped)
    assert (dropped.cause, "more than 64 publishers" in dropped.detail) == (Drop.UNKNOWN_SOURCE, True)
    bench.source.connect([link.uri for link in new[1:]], now)
    assert {link.uri for link in links if not link.is_closed} == {talking.uri}  # who has spoken gives way last
    bench.source.link_ended(cast("Any", links[0]), None)
    assert not new[0].is_closed


async def test_mapped_topic_with_a_bad_field() -> None:
    bench = Bench()
    feed = MappedFeed(charge(ScalarType.INT32), bench.inlet, asyncio.get_running_loop())
    bench.source._feeds = [feed]
    link = Link(Float64)
    (found,) = bench.look(link)
    assert isinstance(found, SourceFound)
    assert (found.name, [(field.name, field.builtin_type) for field in found.fields]) == (
        "/charge",
        [("Charge", BuiltinType.INT32)],
    )
    (sample,) = bench.hear(link, Float64(41.6))
    assert isinstance(sample, SampleRead)
    assert sample.values == (42,)
    dropped, sample = bench.hear(link, Float64(float("nan")))
    assert isinstance(sample, SampleRead)
    assert sample.values == (Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_OUT_OF_RANGE),)
    assert dropped == Dropped(Drop.CONVERSION, 1, "/charge field Charge: nan does not fit into Int32")


async def test_rate_limit_of_a_mapped_topic_delivers_the_last_before_the_loss() -> None:
    bench = Bench()
    data = charge(ScalarType.DOUBLE, max_rate_hz=0.01)
    bench.source._feeds = [MappedFeed(data, bench.inlet, asyncio.get_running_loop())]
    link = Link(Float64)
    events: list[DriverEvent] = []
    for number in range(4):
        events += bench.hear(link, Float64(number))
    events += [*bench.look(link), *bench.look(), *bench.look()]
    assert kinds(events) == ["SourceFound", "SampleRead", "Dropped", "Dropped", "SampleRead", "SourceLost"]
    samples = [event.values for event in events if isinstance(event, SampleRead)]
    assert samples == [(0.0,), (3.0,)]


def restarted(bench: Bench, folder: Path) -> Bench:
    bench.memory.close()
    return Bench(folder=folder)


def time_of(events: list[DriverEvent]) -> int:
    sample = events[-1]
    assert isinstance(sample, SampleRead)
    return sample.source_time_ns


def test_latched_message_that_the_bridge_before_had_heard_keeps_its_time(tmp_path: Path) -> None:
    first = Bench(folder=tmp_path)
    link = Link(Float64, latched=True)
    first.hear(link, Float64(1.0))
    heard_ns = time_of(first.hear(link, Float64(2.0)))
    second = restarted(first, tmp_path)
    again = Link(Float64, latched=True)
    assert time_of(second.hear(again, Float64(2.0))) == heard_ns
    assert time_of(second.hear(again, Float64(2.0))) > heard_ns
    third = restarted(second, tmp_path)
    assert time_of(third.hear(Link(Float64, latched=True), Float64(3.0))) > heard_ns
    third.memory.close()


def test_latched_message_of_a_robot_that_was_restarted_too_is_news(tmp_path: Path) -> None:
    first = Bench(folder=tmp_path)
    link = Link(Float64, latched=True)
    first.look(link)
    heard_ns = time_of(first.hear(link, Float64(2.0)))
    second = restarted(first, tmp_path)
    again = Link(Float64, latched=True)
    again.uri = "http://robot:2/"
    second.look(again)
    assert time_of(second.hear(again, Float64(2.0))) > heard_ns
    second.memory.close()


def test_latched_message_of_a_source_that_was_lost_is_news(tmp_path: Path) -> None:
    first = Bench(folder=tmp_path)
    heard_ns = time_of(first.hear(Link(Float64, latched=True), Float64(2.0)))
    for _ in range(2):
        first.look()
    second = restarted(first, tmp_path)
    assert time_of(second.hear(Link(Float64, latched=True), Float64(2.0))) > heard_ns
    second.memory.close()


def test_message_that_is_not_latched_is_always_news(tmp_path: Path) -> None:
    first = Bench(folder=tmp_path)
    heard_ns = time_of(first.hear(Link(Float64), Float64(2.0)))
    second = restarted(first, tmp_path)
    assert time_of(second.hear(Link(Float64), Float64(2.0))) > heard_ns
    second.memory.close()
