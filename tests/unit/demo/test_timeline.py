"""The timeline of the assembly line, fed with events at chosen times."""

from __future__ import annotations

import pytest
from ua_demo.lines import LineEvent
from ua_demo.pal.timeline import Timeline, percentiles

START = 1000.0


def _say(timeline: Timeline, line_s: float, who: str, what: str, **details: object) -> str | None:
    return timeline.add(LineEvent(START + line_s / timeline.speed, who, what, details))


def _run(timeline: Timeline) -> None:
    _say(timeline, 0, "ned", "starts", covers=4)
    _say(timeline, 8, "ned", "places a cover", carrier="conveyor", count=1)
    _say(timeline, 12, "human", "takes a cover", carrier="conveyor", boxes=1)
    _say(timeline, 18, "ned", "places a cover", carrier="conveyor", count=2)
    _say(timeline, 22, "human", "takes a cover", carrier="conveyor", boxes=2)
    _say(timeline, 29, "ned", "places a cover", carrier="turtlebot3", count=1)
    _say(timeline, 51, "human", "takes a cover", carrier="turtlebot3", boxes=3)
    _say(timeline, 76, "ned", "places a cover", carrier="turtlebot3", count=2)


def test_all_delivered_only_after_the_last_cover_arrived() -> None:
    timeline = Timeline(speed=10)
    _run(timeline)
    before = timeline.all_delivered
    _say(timeline, 98, "human", "takes a cover", carrier="turtlebot3", boxes=4)
    assert (before, timeline.all_delivered) == (False, True)
    covers = timeline.report(looped=0, drops={}, ros1=True, secure=False)["covers"]
    assert [cover["carrier"] for cover in covers] == ["conveyor", "conveyor", "turtlebot3", "turtlebot3"]
    assert [cover["placed_s"] for cover in covers] == pytest.approx([8, 18, 29, 76])
    assert [cover["delivered_s"] for cover in covers] == pytest.approx([12, 22, 51, 98])


def test_a_cover_that_did_not_arrive_has_no_delivery() -> None:
    timeline = Timeline(speed=1)
    _run(timeline)
    assert timeline.report(looped=0, drops={}, ros1=True, secure=False)["covers"][3]["delivered_s"] is None


def test_a_cover_taken_from_a_carrier_that_holds_none_counts_for_nothing() -> None:
    timeline = Timeline(speed=1)
    _say(timeline, 0, "ned", "starts", covers=4)
    _say(timeline, 1, "ned", "places a cover", carrier="conveyor", count=1)
    _say(timeline, 2, "human", "takes a cover", carrier="turtlebot3", boxes=1)
    assert timeline.covers[0].delivered_s is None


def test_delays_are_wall_time_whatever_the_speed() -> None:
    timeline = Timeline(speed=10)
    _say(timeline, 0, "ned", "starts", covers=4)
    _say(timeline, 25, "ned", "sees the conveyor", on=False)
    assert timeline.server_saw_conveyor(on=False, server_time=START + 2.5 + 0.004) is not None
    _say(timeline, 29, "ned", "places a cover", carrier="turtlebot3", count=1)
    timeline.server_saw_counter("turtlebot3", 1, START + 2.9 + 0.003)
    _say(timeline, 29.02, "turtlebot3", "moves to the worker", count=1)
    delays = timeline.report(looped=0, drops={}, ros1=True, secure=False)["delays_ms"]
    assert delays["conveyor_off_to_server"]["max"] == pytest.approx(4, abs=0.01)
    assert delays["counter_to_server"]["max"] == pytest.approx(3, abs=0.01)
    assert delays["placed_to_turtlebot3_moves"]["max"] == pytest.approx(2, abs=0.01)
    assert delays["ros1_to_ros2"] == {"p50": None, "p99": None, "max": None}


def test_measurements_are_not_printed() -> None:
    timeline = Timeline(speed=1)
    assert _say(timeline, 0, "ned", "is ready") is None
    _say(timeline, 0, "ned", "starts", covers=4)
    assert _say(timeline, 1, "human", "hears of the joints", delay_ms=1.5) is None
    assert timeline.ros1_to_ros2_ms == [1.5]
    assert _say(timeline, 2.5, "ned", "picks a cover") == "   2.50 s  ned picks a cover"
    assert _say(timeline, 3, "ned", "sees the conveyor", on=False) == "   3.00 s  ned sees the conveyor (on no)"


@pytest.mark.parametrize(
    ("samples", "p50", "p99", "greatest"),
    [
        ([5.0], 5, 5, 5),
        ([4.0, 1.0, 3.0, 2.0], 2, 4, 4),
        ([float(n) for n in range(1, 101)], 50, 99, 100),
        ([float(n) for n in range(1, 201)], 100, 198, 200),
    ],
)
def test_percentiles_are_nearest_ranks(samples: list[float], p50: float, p99: float, greatest: float) -> None:
    assert percentiles(samples) == {"p50": p50, "p99": p99, "max": greatest}
