"""The server's core in virtual time: datagrams in, changes of nodes and messages out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from tests.unit.fleet.fleet_of import BOOLEAN, BRIDGE, BUSY, DOUBLE, SPEED
from tests.unit.server.core_bench import START, TIMING, Bench
from ua_fleet.counters import Drop
from ua_fleet.fleet.changes import Change, RobotAdded, RobotRemoved, SourceAdded, SourceQuarantined, ValueChanged
from ua_fleet.fleet.commands import Publication
from ua_fleet.fleet.model import RobotState, UnknownSources
from ua_fleet.pubsub.events import DataReceived, SourceSilent
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.server.attached import NoNamespace, NoRegistry, NoRuns, Parts, RunsPart
from ua_fleet.server.core import BURST, BURST_PAUSE_S, MOST_VALUES, TICK_S
from ua_fleet.server.timetable import PAUSE_S
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire import encode_probe
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

NO_COMMUNICATION = int(StatusCode.BAD_NO_COMMUNICATION)
SPEED_FIELD, BUSY_FIELD = make_field("data", DOUBLE), make_field("data", BOOLEAN)


def heard_speed(bench: Bench, value: float = 0.25) -> None:
    bench.announce(SPEED, SPEED_FIELD)
    bench.publish(SPEED, value)


# Values.


def test_a_value_is_shown_within_the_call_that_brings_it() -> None:
    bench = Bench()
    bench.announce(SPEED, SPEED_FIELD)
    turns = bench.nodes.turns
    bench.publish(SPEED, 0.25)
    assert bench.nodes.values(1001) == [(0.25, 0)]
    assert bench.nodes.turns == turns + 1


def test_analog_values_are_shown_at_their_rate_and_the_last_one_always() -> None:
    bench = Bench()
    heard_speed(bench, 0.0)
    for number in range(1, 96):  # 1 kHz for 95 ms
        bench.now = number / 1000
        bench.publish(SPEED, number / 100)
    assert bench.nodes.values(1001) == [(0.0, 0)]
    bench.until(0.0999)
    assert bench.nodes.values(1001) == [(0.0, 0)]
    bench.until(0.1001)
    assert bench.nodes.values(1001) == [(0.0, 0), (0.95, 0)]
    bench.until(0.3)
    assert bench.nodes.values(1001) == [(0.0, 0), (0.95, 0)]
    bench.publish(SPEED, 1.0)
    assert bench.nodes.values(1001)[2:] == [(1.0, 0)]


def test_many_values_that_are_due_leave_others_their_turn() -> None:
    count = 2 * MOST_VALUES + 10
    topics = [Topic(2, 2, 2000 + number) for number in range(count)]
    data = {f"d{topic.id}": {"id": topic.id, "type": "Double"} for topic in topics}
    bench = Bench({"rover": {"bridge": "mobile", "capacities": ["mobile"], "data": data}})
    for topic in topics:
        bench.announce(topic, SPEED_FIELD)
        bench.publish(topic, 0.0)
    bench.now = 0.05
    for topic in topics:
        bench.publish(topic, 1.0)
    bench.now = 0.11

    def shown() -> int:
        return sum(bench.nodes.values(topic.id)[-1] == (1.0, 0) for topic in topics)

    has_more = [bench.core.poll(now=0.11, wall=bench.wall())]
    assert shown() == MOST_VALUES
    has_more += [bench.core.poll(now=0.11, wall=bench.wall()) for _ in range(2)]
    assert shown() == count
    assert has_more == [True, True, False]


def test_a_boolean_is_shown_at_each_message() -> None:
    bench = Bench()
    bench.announce(BUSY, BUSY_FIELD)
    for number in range(50):
        bench.now = number / 1000
        bench.publish(BUSY, number % 2 == 0)
    assert bench.nodes.values(1002) == [(number % 2 == 0, 0) for number in range(50)]


# Metadata and probes.


def test_data_before_its_metadata_is_dropped_counted_and_probed_for() -> None:
    bench = Bench()
    bench.bridge.announce(SPEED, "speed", (SPEED_FIELD,), now=0.0, wall_ticks=bench.wall())  # nobody hears it
    bench.publish(SPEED, 0.25)
    assert bench.nodes.values(1001) == []
    assert bench.counters.drops[Drop.NO_METADATA] == 1
    bench.until(2.0)
    ((at, probe),) = bench.probes()[:1]
    assert 0 <= at < 2
    assert (probe.publisher_id, probe.kind, probe.data_set_writer_ids) == (2, ProbeKind.DATA_SET_META_DATA, (SPEED.id,))
    bench.hear(bench.bridge.answer(probe, bench.now))
    bench.publish(SPEED, 0.5)
    bench.until(bench.now + 0.2)
    assert bench.nodes.values(1001)[-1] == (0.5, 0)


def test_a_field_of_another_type_is_told_by_its_status() -> None:
    bench = Bench()
    bench.announce(SPEED, make_field("data", BOOLEAN))
    bench.publish(SPEED, True)
    assert [status for _, status in bench.nodes.values(1001)] == [int(StatusCode.BAD_TYPE_MISMATCH)]


@pytest.mark.parametrize(
    ("policy", "expected"),
    [(UnknownSources.CREATE, [SourceAdded, ValueChanged]), (UnknownSources.QUARANTINE, [SourceQuarantined])],
)
def test_an_unknown_source_comes_under_the_policy(policy: UnknownSources, expected: Sequence[type]) -> None:
    bench = Bench(policy=policy)
    stranger = Topic(2, 2, 1777)
    bench.announce(stranger, SPEED_FIELD)
    bench.publish(stranger, 1.5)
    of_it = [change for change in bench.nodes.changes if not isinstance(change, ValueChanged) or change.value == 1.5]
    assert [type(change) for change in of_it] == expected


def test_the_server_answers_probes_with_what_it_announces() -> None:
    bench = Bench()
    bench.begin()
    before = len(bench.announced())
    bench.hear([encode_probe(Probe(0, PublisherIdType.UINT16.value, ProbeKind.DATA_SET_META_DATA.value, (1006,)))])
    bench.until(1.0)
    assert 1006 in [one for _, one in bench.announced()[before:]]


# Liveness.


def test_a_silent_source_is_bad_with_its_last_value_and_comes_back() -> None:
    bench = Bench()
    heard_speed(bench)
    bench.until(10.0, bridge=True)
    assert bench.nodes.values(1001) == [(0.25, 0)]
    gone_at = bench.now
    bench.until(gone_at + TIMING.receive_timeout_s + 0.5)
    assert bench.nodes.values(1001)[1:] == [(0.25, NO_COMMUNICATION)]
    bench.until(bench.now + 1, bridge=True)
    assert bench.nodes.values(1001)[2:] == [(0.25, 0)]


def test_silence_is_told_at_the_timeout_and_not_before() -> None:
    bench = Bench()
    heard_speed(bench)
    bench.until(TIMING.receive_timeout_s - 0.01)
    assert bench.nodes.values(1001) == [(0.25, 0)]
    bench.until(TIMING.receive_timeout_s + 0.01)
    assert bench.nodes.values(1001) == [(0.25, 0), (0.25, NO_COMMUNICATION)]


# Ticks.


def test_each_second_robots_and_the_server_are_looked_at() -> None:
    bench, seconds = Bench(), list[float]()
    heard_speed(bench)
    bench.until(0.5)
    assert bench.state.robot_states["rover"] is not RobotState.OFFLINE
    shown = bench.nodes.values("Robots.rover.LastUpdate")
    for second in range(1, 4):
        bench.until((second - 0.5) * TICK_S)
        bench.publish(SPEED, second / 10)
        seconds += bench.until(second * TICK_S)
    assert len(bench.nodes.values("Robots.rover.LastUpdate")) == len(shown) + 3
    assert {1.0, 2.0, 3.0} <= set(seconds)
    counted = bench.nodes.values("Fleet.Traffic.MessagesIn")
    assert counted[-1][0] >= 4


# The beginning.


def many_goals(count: int) -> dict[str, Any]:
    data = {
        f"goal{number}": {"id": 2001 + number, "type": "Double", "origin": "server", "initial": 0.5}
        for number in range(count)
    }
    return {"rover": {"bridge": "mobile", "data": data}}


def test_what_originates_here_is_announced_and_said_in_bursts() -> None:
    count = 2 * BURST + 5
    bench = Bench(many_goals(count))
    bench.begin()
    assert [one for _, one in bench.announced()] == list(range(2001, 2001 + BURST))
    bench.until(0.5)
    # Each again is the repetition of what a receiver may have missed.
    assert [one for _, one in bench.announced()[:count]] == list(range(2001, 2001 + count))
    assert [one for _, one in bench.published()[:count]] == list(range(2001, 2001 + count))
    times = [at for at, _ in (*bench.announced()[:count], *bench.published()[:count])]
    at_once = [times.count(at) for at in sorted(set(times))]
    assert at_once == [BURST, BURST, 5 + BURST, BURST, 5]
    assert max(times) == pytest.approx(4 * BURST_PAUSE_S)


def test_a_robot_that_comes_between_two_bursts_is_announced_as_well() -> None:
    bench = Bench(many_goals(BURST + 5))
    bench.begin()
    other = Bench({"late": {"bridge": "mobile", "data": {"aim": {"id": 3001, "type": "Double", "origin": "server"}}}})
    bench.core.add_robot(other.model.robots[0], now=bench.now, wall=bench.wall())
    bench.until(0.5)
    ids = {one for _, one in bench.announced()}
    assert sorted(ids) == [*range(2001, 2001 + BURST + 5), 3001]
    assert not bench.mistakes.count


def test_the_actions_of_a_robot_that_is_gone_are_asked_for_no_longer() -> None:
    bench = Bench()
    bench.begin()
    late = {"bridge": "mobile", "skill_status_id": 3000, "skills": {"turn": {"id": 3001}}}
    (robot,) = Bench({"late": late}).model.robots
    bench.core.add_robot(robot, now=bench.now, wall=bench.wall())
    bench.until(1.0)
    bench.core.remove_robot(robot, now=bench.now)
    bench.until(100.0)
    times = [at for at, probe in bench.probes() if 3001 in probe.data_set_writer_ids]
    assert times
    assert max(times) <= 1.0


# What clients write.


def test_what_clients_write_is_sent_with_the_next_flush() -> None:
    bench = Bench()
    bench.begin()
    bench.until(0.1)
    said = len([one for _, one in bench.sent if hasattr(one, "messages")])
    key = bench.model.robots[0].data_sets[-1].fields[0].key
    for value in (0.5, 0.75):
        _, before = bench.ground.commands.write(key, DOUBLE, value, None, bench.wall())
        if before is not None:
            bench.core.publish(before, now=bench.now)
    bench.core.flush(now=bench.now)
    messages = [one for _, one in bench.sent if hasattr(one, "messages")]
    assert [part.values for one in messages[said:] for part in one.messages] == [(0.5,), (0.75,)]


def test_what_cannot_be_encoded_is_counted() -> None:
    bench = Bench()
    bench.begin()
    bench.core.publish(Publication(Topic(0, 2, 1006), (DOUBLE,), ("no number",), START), now=0.0)
    assert bench.core.refused == 1


# Parts.


class Noting(NoRuns):
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def heard(self, event: DataReceived) -> None:
        self.told.append(f"heard {event.topic.id}")

    def source_lost(self, topic: Topic) -> None:
        self.told.append(f"lost {topic.id}")

    def source_returned(self, topic: Topic) -> None:
        self.told.append(f"returned {topic.id}")

    def value_changed(self, change: ValueChanged) -> None:
        self.told.append(f"value {change.key.identifier!s}")

    def end_batch(self) -> None:
        self.told.append("end")


def test_runs_hear_of_a_batch_before_they_decide() -> None:
    runs = Noting()
    bench = Bench(parts=Parts(runs=runs))
    heard_speed(bench)
    bench.announce(BUSY, BUSY_FIELD)
    bench.publish(BUSY, True)
    runs.told.clear()
    bench.core.hear([SourceSilent(SPEED), SourceSilent(BUSY)], now=1.0, wall=bench.wall())
    ours = [one for one in runs.told if one.split()[-1] in ("1001", "1002", "end")]
    assert ours == ["value 1001", "lost 1001", "value 1002", "lost 1002", "end"]


class Failing(NoRuns):
    """Does not understand anything."""

    def value_changed(self, change: ValueChanged) -> None:
        raise ValueError("a value")

    def heard(self, event: DataReceived) -> None:
        raise ValueError("data")

    def end_batch(self) -> None:
        raise ValueError("a batch")

    def poll(self) -> None:
        raise ValueError("time")

    def next_deadline(self) -> float | None:
        return 0.0


def test_a_part_that_fails_costs_nobody_a_value_and_itself_a_second() -> None:
    runs: RunsPart = Failing()
    bench = Bench(parts=Parts(runs=runs))
    heard_speed(bench)
    assert bench.nodes.values(1001) == [(0.25, 0)]
    assert bench.mistakes.counts["changes"]
    polled = bench.mistakes.counts["scenarios"]
    bench.until(3.5 * PAUSE_S)
    assert bench.mistakes.counts["scenarios"] - polled <= 5


class Registry(NoRegistry):
    """Counts its seconds."""

    ticks = 0

    def tick(self) -> None:
        self.ticks += 1


def test_the_registry_is_told_of_each_second() -> None:
    registry = Registry()
    bench = Bench(parts=Parts(registry=registry))
    bench.until(5.5)
    assert registry.ticks == 6


def test_a_bridge_is_heard_by_its_status_and_missed_after_the_timeout() -> None:
    bench = Bench()
    bench.announce(BRIDGE, make_field("Connected", BOOLEAN))
    bench.publish(BRIDGE, True)
    assert bench.state.bridges_heard == {"mobile": True}
    bench.until(TIMING.receive_timeout_s + 0.5)
    assert bench.state.bridges_heard == {"mobile": False}


# The Unified Namespace.


class Mirror(NoNamespace):
    """What it is told."""

    def __init__(self) -> None:
        self.values: list[tuple[Any, Any]] = []
        self.changes: list[Change] = []
        self.publications: list[Publication] = []

    def value_changed(self, change: ValueChanged) -> None:
        self.values.append((change.key.identifier, change.value))

    def changed(self, change: Change) -> None:
        self.changes.append(change)

    def written(self, publication: Publication) -> None:
        self.publications.append(publication)


def test_the_unified_namespace_is_told_of_each_value_also_of_those_that_nodes_wait_for() -> None:
    mirror = Mirror()
    bench = Bench(parts=Parts(namespace=mirror, runs=Failing()))
    heard_speed(bench, 0.0)
    for number in range(1, 5):
        bench.now = number / 1000
        bench.publish(SPEED, number / 10)
    assert [value for key, value in mirror.values if key == 1001] == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert bench.nodes.values(1001) == [(0.0, 0)]


def test_the_unified_namespace_is_told_of_robots_and_of_what_clients_write() -> None:
    mirror = Mirror()
    bench = Bench(parts=Parts(namespace=mirror))
    bench.begin()
    goal = Publication(Topic(0, 2, 1006), (DOUBLE,), (0.5,), START)
    bench.core.publish(goal, now=0.0)
    assert mirror.publications[-1] == goal
    (rover,) = bench.model.robots
    bench.core.remove_robot(rover, now=0.0)
    bench.core.add_robot(rover, now=0.0, wall=START)
    kinds = [type(change) for change in mirror.changes]
    assert [kind for kind in kinds if kind in (RobotAdded, RobotRemoved)] == [RobotRemoved, RobotAdded]
