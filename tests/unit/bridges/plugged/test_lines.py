"""What is said on a serial port: commands, their answers, and more lines than can be looked at."""

from __future__ import annotations

from typing import Any

import pytest
from ua_bridges.plugged.config import PluggedBridgeConfig, PluggedSink, PluggedSkill, PluggedSource
from ua_bridges.plugged.lines import LONGEST_LINE, MOST_LINES, MOST_LONG, Lines
from ua_bridges.plugged.sensor import Sensor

from ua_fleet.bridge import DriverEvent, Dropped, Execution, ExecutionEnded, ExecutionForgotten, SampleRead
from ua_fleet.bridge.configured import configured_sinks, configured_skills, configured_sources
from ua_fleet.bridge.executing import Executing
from ua_fleet.config.load import load_content
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

FLEET = r"""
version: 1
pubsub: {security: none}
bridges: {pc: {kind: plugged, space: 300, status_id: 1, devices: {box: {path: /dev/box}}}}
robots:
  rover_pc:
    bridge: pc
    skill_status_id: 2
    data:
      level: {id: 10, type: Double, source: {device: box, line: "L {value}", when: always}}
      light: {id: 11, type: Double, origin: server, sink: {device: box, command: "LIGHT {value}\n"}}
    skills:
      open:
        id: 20
        via: {device: box, command: "OPEN\n", done: "OK", failed: "ERR {message}", halt: "HUSH\n", halted: "HUSHED"}
      close: {id: 21, via: {device: box, command: "CLOSE\n"}}
"""


class Bench:
    def __init__(self) -> None:
        config = load_content(FLEET.encode(), "f.yaml", {})
        bridge = config.bridges["pc"]
        assert isinstance(bridge, PluggedBridgeConfig)
        self.told: list[DriverEvent] = []
        self.sent: list[bytes] = []
        self.asides: list[str] = []
        self.takes = True
        self.skills = {skill.name: skill for skill in configured_skills(config, "pc", PluggedSkill)}
        executing = Executing(self.told.append)
        self.lines = Lines(
            "box",
            bridge.devices["box"].port,
            [Sensor(data, self.told.append, executing) for data in configured_sources(config, "pc", PluggedSource)],
            list(self.skills.values()),
            configured_sinks(config, "pc", PluggedSink),
            self.told.append,
            executing,
            self._write,
            lambda _key, data: self._write(data),
            self._reset,
            lambda: None,
            self.asides.append,
        )
        self.executing = executing
        self.lines.opened(0.0, 1)
        self.lines.begin_listening()
        self.lines.received(b"L 0\n", 0.1, 1)

    def _write(self, data: bytes) -> bool:
        if self.takes:
            self.sent.append(data)
        return self.takes

    def _reset(self, why: str) -> None:
        self.lines.closed(why, 1.0)

    def execute(self, name: str) -> Execution:
        skill = self.skills[name]
        execution = Execution(name.encode().ljust(16), skill.topic, 1, (), 5.0)
        self.lines.execute(skill, execution, 0.2)
        return execution

    def facts(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.told if isinstance(event, kind)]

    def drops(self, cause: Drop) -> int:
        return sum(event.count for event in self.facts(Dropped) if event.cause is cause)


@pytest.mark.parametrize(("said", "status"), [(b"OK\n", 0), (b"ERR stuck\n", StatusCode.BAD_UNEXPECTED_ERROR)])
def test_an_answer_is_found_in_a_flood(said: bytes, status: int) -> None:
    bench = Bench()
    bench.execute("open")
    bench.lines.received(said + b"".join(b"L %d\n" % number for number in range(100)), 0.3, 1)
    assert [ended.status for ended in bench.facts(ExecutionEnded)] == [status]
    assert bench.drops(Drop.RATE_LIMITED) >= 101 - MOST_LINES - 1
    bench.lines.received(b"L 7\n", 5.0, 1)
    assert bench.facts(SampleRead)[-1].values == (7.0,)


def test_one_answer_is_awaited_at_a_time() -> None:
    bench = Bench()
    bench.execute("open")
    with pytest.raises(RobotBusy, match=r"has not answered rover_pc\.open yet"):
        bench.execute("open")


CANCELLED = StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT


@pytest.mark.parametrize(("said", "status"), [(b"HUSHED\n", CANCELLED), (b"ERR stuck\n", CANCELLED), (b"OK\n", 0)])
def test_a_device_is_halted_once_it_says_so(said: bytes, status: int) -> None:
    bench = Bench()
    execution = bench.execute("open")
    bench.lines.received(b"HUSHED\n", 0.3, 1)
    bench.lines.halt(execution, 0.4)
    assert bench.sent[-1] == b"HUSH\n"
    assert bench.executing.overdue(5.3) == []
    assert bench.facts(ExecutionEnded) == [], "bytes that were written have stopped nothing yet"
    bench.lines.received(said, 5.3, 1)
    assert [ended.status for ended in bench.facts(ExecutionEnded)] == [status]


def test_a_device_that_says_nothing_of_its_halt_is_not_halted() -> None:
    bench = Bench()
    bench.lines.halt(bench.execute("open"), 0.4)
    (overdue,) = bench.executing.overdue(5.4)
    assert bench.lines.overdue(overdue)
    assert bench.facts(ExecutionEnded) == []
    (forgotten,) = bench.facts(ExecutionForgotten)
    assert "its standstill is not confirmed" in forgotten.message


def test_what_could_not_be_written_is_not_done() -> None:
    bench = Bench()
    bench.takes = False
    bench.execute("close")
    bench.execute("open")
    ended = bench.facts(ExecutionEnded)
    assert [each.status for each in ended] == [StatusCode.BAD_NO_COMMUNICATION] * 2
    assert all("before it was written to" in each.message for each in ended)
    assert not bench.lines.inform(Topic(0, 2, 11), (0.5,))
    assert bench.drops(Drop.NOT_CONNECTED) == 1
    bench.takes = True
    execution = bench.execute("open")  # it waits for no answer to the one before
    bench.takes = False
    with pytest.raises(RobotOffline, match="before it was written to"):
        bench.lines.halt(execution, 0.3)
    assert len(bench.facts(ExecutionEnded)) == 2
    assert bench.sent == [b"OPEN\n"]


def test_a_device_that_ends_no_line_is_put_aside_and_one_that_errs_is_not() -> None:
    bench = Bench()
    for _ in range(3):
        for _ in range(MOST_LONG - 1):
            bench.lines.received(b"x" * (LONGEST_LINE + 1), 1.0, 1)
        bench.lines.received(b"\nL 1.0\n", 1.0, 1)
    assert bench.asides == []
    for _ in range(MOST_LONG):
        bench.lines.received(b"x" * (LONGEST_LINE + 1), 1.0, 1)
    assert bench.asides == ["more than 40960 bytes without the end of a line"]


def test_each_value_that_a_line_did_not_take_is_counted_by_its_cause() -> None:
    bench = Bench()
    light = Topic(0, 2, 11)
    bench.lines.overtaken(light)
    bench.lines.overtaken(light)
    bench.lines.never_sent(light)
    bench.lines.overtaken(b"LIGHT?\n")
    bench.lines.never_sent(b"LIGHT?\n")  # a question is asked again
    assert (bench.drops(Drop.RATE_LIMITED), bench.drops(Drop.NOT_CONNECTED)) == (2, 1)
    first, second, lost = [event.detail for event in bench.facts(Dropped)]
    assert first == "box: rover_pc.light: values come faster than the line takes them; the newest is sent"
    assert (second, "before it was written to" in lost) == ("", True)
