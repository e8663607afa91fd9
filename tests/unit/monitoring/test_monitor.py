"""What a monitor tells, read by the strict parser of OpenMetrics."""

from __future__ import annotations

import re

import pytest

from tests.scraped import OPENMETRICS, Samples, samples
from ua_fleet.counters import Counters, Drop
from ua_fleet.monitoring import METRICS, MetricKind, Monitor, ProcessKind, metrics
from ua_fleet.monitoring.counted import counted, keys_left, transported
from ua_fleet.monitoring.reference import table
from ua_fleet.transport.base import TransportStats


def told(monitor: Monitor) -> Samples:
    """All samples, by name and values of labels."""
    body, content_type = monitor.exposition(OPENMETRICS)
    assert content_type.startswith(OPENMETRICS)
    return samples(body.decode())


def test_a_new_monitor_says_what_it_is_and_that_it_is_not_ready() -> None:
    monitor = Monitor(ProcessKind.BRIDGE, "cell")
    shown = told(monitor)
    assert shown["ua_fleet_ready",] == 0
    ((build, value),) = [(key, value) for key, value in shown.items() if key[0] == "ua_fleet_build_info"]
    assert {"bridge", "cell"} < set(build)
    assert value == 1
    assert shown["process_resident_memory_bytes",] > 1e6
    monitor.ready_when(str)
    assert told(monitor)["ua_fleet_ready",] == 1


def test_without_a_wish_the_format_is_that_of_old() -> None:
    body, content_type = Monitor(ProcessKind.SERVER).exposition()
    assert content_type.startswith("text/plain; version=0.0.4")
    assert b"# TYPE ua_fleet_loop_lag_seconds histogram\n" in body
    assert b"_created" not in body


def test_each_counter_is_told() -> None:
    counters, stats, monitor = Counters(), TransportStats(), Monitor(ProcessKind.BRIDGE)
    monitor.add(lambda: counted(counters, has_space=True))
    monitor.add(lambda: transported(stats))
    monitor.add(lambda: keys_left({"t-1": 7200.0}, "it is away"))
    before = told(monitor)
    assert {key[1] for key in before if key[0] == "ua_fleet_drops_total"} == {drop.value for drop in Drop}
    counters.messages_in, counters.messages_out, counters.from_space, counters.to_space = 1, 2, 3, 4
    counters.gaps, counters.looped = 5, 6
    counters.drop(Drop.CONFLICT, 7)
    counters.drop_malformed("truncated")
    stats.received, stats.sent, stats.receive_buffer_bytes = 8, 9, 10
    after = told(monitor)
    moved = {key: value for key, value in after.items() if before.get(key) != value and key[0].startswith("ua_")}
    assert moved == {
        ("ua_fleet_dataset_messages_received_total",): 1,
        ("ua_fleet_dataset_messages_sent_total",): 2,
        ("ua_fleet_space_messages_received_total",): 3,
        ("ua_fleet_space_messages_published_total",): 4,
        ("ua_fleet_sequence_gaps_total",): 5,
        ("ua_fleet_looped_total",): 6,
        ("ua_fleet_drops_total", "conflict"): 7,
        ("ua_fleet_drops_total", "malformed"): 1,
        ("ua_fleet_malformed_total", "truncated"): 1,
        ("ua_fleet_datagrams_received_total",): 8,
        ("ua_fleet_datagrams_sent_total",): 9,
        ("ua_fleet_receive_buffer_bytes",): 10,
    }
    assert after["ua_fleet_key_remaining_seconds", "t-1"] == 7200
    assert after["ua_fleet_key_source_up",] == 0


def test_the_server_has_no_space_of_its_own() -> None:
    names = {family.name for family in counted(Counters(), has_space=False)}
    assert not any("space" in name for name in names)


def test_names_follow_the_conventions() -> None:
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    for metric in METRICS:
        assert re.fullmatch(r"ua_fleet_[a-z_]+", metric.name)
        assert metric.name.endswith("_total") == (metric.kind is MetricKind.COUNTER)
        assert metric.help.endswith(".")
        assert "|" not in metric.help
        assert f"| `{metric.name}` |" in table()


@pytest.mark.parametrize("text", ["a\\b", 'say "x"', "two\nlines", "ü"])
def test_labels_may_hold_anything(text: str) -> None:
    monitor = Monitor(ProcessKind.SERVER)
    monitor.add(lambda: [metrics.ROBOT_UP.many([((text,), 1)])])
    assert told(monitor)["ua_fleet_robot_up", text] == 1
