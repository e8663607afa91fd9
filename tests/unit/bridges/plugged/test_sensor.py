"""A sensor: there while it is plugged in, read while somebody needs it."""

from __future__ import annotations

from typing import Any

import pytest
from ua_bridges.plugged.config import PluggedSkill, PluggedSource
from ua_bridges.plugged.files import value_of
from ua_bridges.plugged.sensor import Sensor

from ua_fleet.bridge import DriverEvent, Dropped, Execution, ExecutionEnded, SampleRead, SourceFound, SourceLost
from ua_fleet.bridge.configured import configured_skills, configured_sources
from ua_fleet.bridge.executing import Executing
from ua_fleet.config.base import ScalarType
from ua_fleet.config.load import load_content
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

FLEET = """\
version: 1
pubsub: {security: none}
bridges: {pc: {kind: plugged, space: 300, status_id: 1, devices: {box: {path: /dev/box}}}}
robots:
  rover_pc:
    bridge: pc
    skill_status_id: 9
    data: {level: {id: 10, type: Double, source: {device: box, line: "L {value}", ask: "L?", SOURCE}}}
    skills: {read: {id: 12, results: {value: {type: Double}}, via: {read: level}}}
"""


def is_needed(sensor: Sensor) -> bool:
    """Read anew: a type checker takes a property for a constant."""
    return sensor.is_needed


class Bench:
    def __init__(self, source: str = "period_s: 1") -> None:
        config = load_content(FLEET.replace("SOURCE", source).encode(), "f.yaml", {})
        self.told: list[DriverEvent] = []
        (data,) = configured_sources(config, "pc", PluggedSource)
        (self.skill,) = configured_skills(config, "pc", PluggedSkill)
        self.sensor = Sensor(data, self.told.append, Executing(self.told.append))

    def take(self, value: Any, now: float) -> None:
        self.sensor.take({"value": value}, now, int(now * 1e9))

    def read(self, now: float) -> None:
        self.sensor.read(self.skill, Execution(bytes(16), Topic(300, 2, 12), 1, ()), now)

    def kinds(self) -> list[str]:
        return [type(event).__name__ for event in self.told]

    def statuses(self) -> list[int]:
        return [event.status for event in self.told if isinstance(event, SampleRead)]

    def values(self) -> list[Any]:
        return [event.values[0] for event in self.told if isinstance(event, SampleRead) and event.status == 0]


def test_it_is_needed_while_it_is_wanted() -> None:
    bench = Bench()
    bench.sensor.want(True, 0)
    assert not is_needed(bench.sensor)
    bench.sensor.plugged(1, 1)
    assert is_needed(bench.sensor)
    bench.take(1.5, 2)
    bench.sensor.want(False, 3)
    assert not is_needed(bench.sensor)
    bench.take(2.5, 4)
    assert bench.values() == [1.5]
    waiting, last = StatusCode.BAD_WAITING_FOR_INITIAL_DATA, StatusCode.UNCERTAIN_LAST_USABLE_VALUE
    assert bench.statuses() == [waiting, 0, last]
    bench.sensor.unplugged("out", 5)
    assert bench.kinds() == ["SourceFound", *["SampleRead"] * 3, "SourceLost"]


def test_always_is_always() -> None:
    bench = Bench("when: always")
    bench.sensor.plugged(0, 0)
    bench.sensor.want(False, 1)
    assert is_needed(bench.sensor)


def test_a_silent_one_is_lost_asked_on_and_met_again() -> None:
    bench = Bench()
    bench.sensor.plugged(0, 0)
    assert bench.sensor.turn(100) is None
    bench.sensor.want(True, 100)
    assert bench.sensor.turn(100) == 103
    assert bench.sensor.turn(103) is None
    assert isinstance(bench.told[-2], SourceLost)
    assert bench.told[-1] == Dropped(Drop.NO_ANSWER, 1, "rover_pc.level: it says nothing; it is asked until it does")
    bench.sensor.want(False, 104)
    assert is_needed(bench.sensor)
    bench.take(1.0, 105)
    assert not is_needed(bench.sensor)
    assert [isinstance(event, SourceFound) for event in bench.told].count(True) == 2


def test_a_reading_has_the_next_value() -> None:
    bench = Bench()
    bench.sensor.plugged(0, 0)
    bench.read(1)
    assert is_needed(bench.sensor)
    bench.take(4, 2)
    assert bench.told[-2] == ExecutionEnded(bytes(16), 0, (4.0,))
    assert bench.statuses()[-1] == StatusCode.UNCERTAIN_LAST_USABLE_VALUE
    assert not is_needed(bench.sensor)


def test_a_reading_that_does_not_fit_or_is_pulled_out() -> None:
    bench = Bench()
    bench.sensor.plugged(0, 0)
    bench.read(1)
    bench.take("warm", 2)
    ended = next(event for event in bench.told if isinstance(event, ExecutionEnded))
    assert ended.status == StatusCode.BAD_TYPE_MISMATCH
    assert "'warm'" in ended.message
    bench.read(3)
    bench.sensor.unplugged("box was unplugged", 4)
    assert bench.told[-1] == ExecutionEnded(bytes(16), StatusCode.BAD_NO_COMMUNICATION, (), "box was unplugged")


def test_of_a_flood_the_latest_passes_and_all_is_counted() -> None:
    bench = Bench("max_rate_hz: 10")
    bench.sensor.plugged(0, 0)
    bench.sensor.want(True, 0)
    for number in range(1000):
        bench.take(float(number), 1 + number / 1000)
    due = bench.sensor.turn(2)
    while due is not None and due < 3:
        due = bench.sensor.turn(due)
    values = bench.values()
    assert values[:10] == [float(number) for number in range(10)]
    assert values[-1] == 999.0
    assert 18 <= len(values) <= 22
    dropped = sum(event.count for event in bench.told if isinstance(event, Dropped))
    assert dropped + len(values) == 1000


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [("42500", ScalarType.DOUBLE, 42.5), ("42500", ScalarType.INT16, 42), ("on", ScalarType.STRING, "on")],
)
def test_files_have_scaled_numbers_and_texts(text: str, kind: ScalarType, value: Any) -> None:
    assert value_of(text, kind, 0.001, 0.0) == value
    assert value_of("1", ScalarType.BOOLEAN, 1, 0) is True
    with pytest.raises(ValueError, match="neither 0 nor 1"):
        value_of("yes", ScalarType.BOOLEAN, 1, 0)
