"""Commands in a robot's own language, and the lines that answer them."""

from __future__ import annotations

from typing import Any

import pytest
from ua_bridges.tcp.config import TcpBridgeConfig, TcpSink, TcpSkillMapping, TcpSource
from ua_bridges.tcp.direct import MOST_LINES, DirectSession

from tests.unit.bridges.tcp.tcp_fleet import fleet
from ua_fleet.bridge.configured import configured_sinks, configured_skills, configured_sources
from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionProgressed,
    SampleRead,
    SourceFound,
    SourceLost,
)
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline, SkillRejected
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode, Variant

NUMBERED = (
    ("{angle}, {name})", "{angle}, {name}, {number})"),
    ("OK {reached}", "OK {number} {reached}"),
    ("ERR {message}", "ERR {number} {message}"),
    ('"STOPPED"', '"STOPPED {number}"'),
)
"""Every line of `move` says which execution it means."""
ID, OTHER = bytes(range(16)), bytes(range(16, 32))
SPEED = Topic(0, 2, 12)


class Robot:
    """A session, and the robot's side of it."""

    def __init__(self, *replaced: tuple[str, str], connected: bool = True) -> None:
        config = fleet(*replaced)
        bridge = config.bridges["cell"]
        assert isinstance(bridge, TcpBridgeConfig)
        assert bridge.direct is not None
        self.told: list[DriverEvent] = []
        self.sent: list[bytes] = []
        self.resets: list[str] = []
        self.offences: list[str] = []
        self.now = 0.0
        self.takes = True
        self.skills = {skill.name: skill for skill in configured_skills(config, "cell", TcpSkillMapping)}
        self.session = DirectSession(
            bridge.direct,
            list(self.skills.values()),
            [*configured_sources(config, "cell", TcpSource), *configured_sinks(config, "cell", TcpSink)],
            self.told.append,
            self._write,
            self._reset,
            self._misbehaves,
            self.now,
        )
        if connected:
            self.session.connected(self.now)
            assert self.sent == [b"COUNT?\n"]
            self.sent.clear()

    def _write(self, data: bytes) -> bool:
        if self.takes:
            self.sent.append(data)
        return self.takes

    def _reset(self, why: str) -> None:
        self.resets.append(why)
        self.session.lost(self.now)

    def _misbehaves(self, why: str) -> None:
        self.offences.append(why)
        self.session.lost(self.now)

    def after(self, seconds: float) -> None:
        self.now += seconds
        self.session.turn(self.now)

    def says(self, text: str) -> None:
        self.session.received(text.encode(), self.now, 5)

    def execute(self, skill: str, *values: Any, execution_id: bytes = ID) -> Execution:
        execution = Execution(execution_id, self.skills[skill].topic, 1, values, 10.0)
        self.session.execute(self.skills[skill], execution, self.now)
        return execution

    def facts(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.told if isinstance(event, kind)]

    def drops(self, cause: Drop) -> int:
        return sum(event.cause is cause for event in self.told if isinstance(event, Dropped))


def test_a_command_and_its_answer() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    assert robot.sent == [b'movej(0.5, "left")\n']
    assert robot.facts(ExecutionProgressed) == [ExecutionProgressed(ID, 0.0, "")]
    robot.says("OK 0.")
    assert robot.facts(ExecutionEnded) == []
    robot.says("49\r\n")
    assert robot.facts(ExecutionEnded) == [ExecutionEnded(ID, 0, (0.49,), "")]


def test_a_failure_with_the_robots_words() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.says("ERR joint limit\n")
    assert robot.facts(ExecutionEnded) == [ExecutionEnded(ID, StatusCode.BAD_UNEXPECTED_ERROR, (), "joint limit")]


def test_without_an_answer_it_is_done_when_it_is_sent() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.execute("home", execution_id=OTHER)
    assert robot.sent[-1] == b"home()\n"
    assert robot.facts(ExecutionEnded)[0][:2] == (OTHER, 0)


def test_what_could_not_be_sent_is_not_done() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.takes = False
    robot.execute("home", execution_id=OTHER)
    (ended,) = robot.facts(ExecutionEnded)
    assert ended[:2] == (OTHER, StatusCode.BAD_NO_COMMUNICATION)
    assert "broke before" in ended.message
    assert not robot.session.inform(SPEED, (0.5,))
    assert robot.drops(Drop.NOT_CONNECTED) == 1


def test_a_command_that_could_not_be_sent_awaits_no_answer() -> None:
    robot = Robot()
    robot.takes = False
    robot.execute("move", 0.5, "left")
    assert robot.facts(ExecutionEnded)[0][:2] == (ID, StatusCode.BAD_NO_COMMUNICATION)
    robot.session.lost(robot.now)
    assert robot.facts(ExecutionForgotten) == []


def test_a_halt_that_could_not_be_sent_is_told() -> None:
    robot = Robot()
    execution = robot.execute("move", 0.5, "left")
    robot.takes = False
    with pytest.raises(RobotOffline, match="broke before"):
        robot.session.halt(execution, robot.now)
    assert robot.facts(ExecutionEnded) == []


def test_one_answer_is_awaited_at_a_time() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    with pytest.raises(RobotBusy, match=r"has not answered arm\.move yet"):
        robot.execute("move", 0.5, "left", execution_id=OTHER)
    robot.says("OK 0.5\n")
    robot.execute("move", 0.5, "left", execution_id=OTHER)


@pytest.mark.parametrize("name", ["a\nstopj()", 'a")', "\x00"])
def test_no_argument_becomes_a_second_command(name: str) -> None:
    robot = Robot()
    with pytest.raises(SkillRejected):
        robot.execute("move", 0.5, name)
    assert robot.sent == []
    assert robot.session.turn(robot.now) == 1.0


def test_a_late_answer_is_nobody_elses() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.after(10.0)
    (ended,) = robot.facts(ExecutionEnded)
    assert (ended.status, ended.message) == (StatusCode.BAD_TIMEOUT, "it took longer than 10 s; it was told to stop")
    assert b"stopj()\n" in robot.sent
    assert "may still come" in robot.resets[0]


def test_where_each_line_has_a_number_the_connection_stays() -> None:
    robot = Robot(*NUMBERED)
    execution = robot.execute("move", 0.5, "left")
    number = robot.sent[0].split(b", ")[2].rstrip(b")\n").decode()
    robot.says("OK 1 0.4\n")
    assert robot.facts(ExecutionEnded) == []
    assert robot.drops(Drop.UNASKED) == 1
    robot.session.halt(execution, robot.now)
    robot.after(5.0)
    assert len(robot.facts(ExecutionForgotten)) == 1
    assert robot.resets == []
    robot.execute("move", 0.5, "left", execution_id=OTHER)
    for late in ("OK {number} 0.4\n", "ERR {number} in its way\n", "STOPPED {number}\n"):
        robot.says(late.format(number=number))
    assert robot.facts(ExecutionEnded) == []


@pytest.mark.parametrize("without", NUMBERED[1:])
def test_a_line_without_a_number_could_be_taken_for_the_next_ones(without: tuple[str, str]) -> None:
    robot = Robot(*(each for each in NUMBERED if each != without))
    robot.session.halt(robot.execute("move", 0.5, "left"), robot.now)
    robot.after(5.0)
    assert [reset.split(", ")[1] for reset in robot.resets] == ["which may still come"]


def test_a_late_answer_with_a_number_could_be_taken_for_another_skills() -> None:
    home = ('home()\\n"', 'home()\\n", done: "HOME", failed: "ERR {message}"')
    robot = Robot(*NUMBERED, home)
    robot.execute("move", 0.5, "left")
    robot.after(10.0)
    assert len(robot.resets) == 1, "`ERR 5 in its way` would be home's failure, too"


def test_a_lost_connection_leaves_it_unknown() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.session.lost(robot.now)
    assert len(robot.facts(ExecutionForgotten)) == 1
    robot.session.query(robot.skills["move"], Execution(OTHER, robot.skills["move"].topic, 1, (0.5, "x"), 1.0), 0.0)
    assert len(robot.facts(ExecutionForgotten)) == 2


def test_what_is_begun_before_the_robot_is_there_waits_for_it() -> None:
    robot = Robot(connected=False)
    robot.execute("move", 0.5, "left")
    with pytest.raises(RobotBusy):
        robot.execute("home", execution_id=OTHER)
    robot.session.connected(1.0)
    assert robot.sent[0] == b'movej(0.5, "left")\n'


def test_but_not_for_long() -> None:
    robot = Robot(connected=False)
    robot.execute("move", 0.5, "left")
    robot.after(3.0)
    assert robot.facts(ExecutionEnded)[0].status == StatusCode.BAD_NO_COMMUNICATION
    with pytest.raises(RobotOffline, match="remote control"):
        robot.execute("home")


@pytest.mark.parametrize(
    ("said", "status", "message"),
    [
        ("STOPPED\n", StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, "it was halted"),
        ("ERR in its way\n", StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, "in its way"),
        ("OK 0.5\n", 0, ""),
    ],
)
def test_halting(said: str, status: int, message: str) -> None:
    robot = Robot()
    robot.session.halt(robot.execute("move", 0.5, "left"), robot.now)
    assert robot.sent[-1] == b"stopj()\n"
    robot.after(4.0)
    assert robot.facts(ExecutionEnded) == [], "bytes that were sent have stopped nothing yet"
    robot.says(said)
    (ended,) = robot.facts(ExecutionEnded)
    assert (ended.status, ended.message) == (status, message)
    assert len(robot.resets) == (said != "STOPPED\n"), "another line leaves the answer to the halt open"


def test_half_a_line_waits_for_its_end_and_is_counted_with_the_connection() -> None:
    robot = Robot()
    robot.says("COUN")
    robot.after(1.0)
    robot.says("T 5\nCOUN")
    robot.after(1.0)
    assert robot.facts(SampleRead)[0].values == (5,)
    assert robot.drops(Drop.MALFORMED) == 0
    robot.session.lost(robot.now)
    robot.session.connected(robot.now)
    robot.session.lost(robot.now)
    assert robot.drops(Drop.MALFORMED) == 1
    assert robot.offences == []


def test_what_the_robot_says_of_a_halt_that_nobody_asked_for_is_no_answer() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.says("STOPPED\n")
    assert robot.facts(ExecutionEnded) == []


def test_a_robot_that_says_nothing_of_its_halt_is_not_halted() -> None:
    robot = Robot()
    execution = robot.execute("move", 0.5, "left")
    robot.session.halt(execution, robot.now)
    robot.after(2.0)
    robot.session.halt(execution, robot.now)
    assert robot.sent.count(b"stopj()\n") == 2
    robot.after(3.0)
    assert robot.facts(ExecutionEnded) == []
    (forgotten,) = robot.facts(ExecutionForgotten)
    assert "its standstill is not confirmed" in forgotten.message
    assert "may still come" in robot.resets[0]


def test_what_was_not_sent_yet_is_halted_at_once() -> None:
    waiting = Robot(connected=False)
    waiting.session.halt(waiting.execute("move", 0.5, "left"), 0.0)
    assert waiting.sent == []
    assert len(waiting.facts(ExecutionEnded)) == 1


def test_data_that_the_robot_is_asked_for() -> None:
    robot = Robot()
    count = robot.facts(SourceFound)[0].topic
    robot.says("COUNT 5\nCOUNT 99999\nwelcome\nwelcome\n")
    bad = Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_TYPE_MISMATCH)
    assert robot.facts(SampleRead) == [SampleRead(count, (5,), 5), SampleRead(count, (bad,), 5)]
    assert robot.drops(Drop.UNASKED) == 2
    robot.after(1.0)
    assert robot.sent == [b"COUNT?\n"]
    robot.after(3.0)
    assert robot.facts(SourceLost) == [SourceLost(count)]
    robot.says("COUNT 6\n")
    assert len(robot.facts(SourceFound)) == 2


def test_values_for_the_robot() -> None:
    robot = Robot()
    assert robot.session.writes(SPEED)
    assert not robot.session.writes(Topic(0, 2, 13))
    assert robot.session.inform(SPEED, (1.005,))
    assert robot.sent == [b"speed(1.00)\n"]
    assert not robot.session.inform(SPEED, (float("nan"),))
    robot.session.lost(robot.now)
    assert not robot.session.inform(SPEED, (1.0,))
    assert (robot.drops(Drop.CONVERSION), robot.drops(Drop.NOT_CONNECTED)) == (1, 1)


def test_a_line_without_end_ends_the_connection() -> None:
    robot = Robot()
    robot.says("x" * 5000)
    assert len(robot.offences) == 1
    assert robot.drops(Drop.MALFORMED) == 1


def test_of_a_flood_of_lines_the_latest_are_looked_at_and_the_answer() -> None:
    robot = Robot()
    robot.execute("move", 0.5, "left")
    robot.session.received(b"OK 0.49\n" + b"COUNT 1\n" * 5000 + b"COUNT 2\n", robot.now, 5)
    assert [sample.values for sample in robot.facts(SampleRead)] == [(1,)] * (MOST_LINES - 1) + [(2,)]
    assert [ended.values for ended in robot.facts(ExecutionEnded)] == [(0.49,)]
    assert (
        Dropped(Drop.RATE_LIMITED, 5001 - MOST_LINES, "the robot says more lines than can be looked at") in robot.told
    )
