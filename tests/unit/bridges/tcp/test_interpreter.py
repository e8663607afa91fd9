"""The exchange with a program on a robot: what is sent, what is asked, and that nothing is done twice."""

from __future__ import annotations

from typing import Any

import pytest
from ua_bridges.tcp.config import InterpreterLink, TcpBridgeConfig, TcpSink, TcpSkillMapping, TcpSource
from ua_bridges.tcp.data import faults_of, subtype_of
from ua_bridges.tcp.interpreter import InterpreterSession, TcpSkill
from ua_bridges.tcp.messages import number_of

from tests.unit.bridges.tcp.tcp_fleet import fleet
from ua_fleet.bridge.configured import configured_sinks, configured_skills, configured_sources
from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    SampleRead,
    SourceFound,
    SourceLost,
)
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotOffline, SkillRejected
from ua_fleet.values import BuiltinType, StatusCode, Variant

ID, OTHER = bytes(range(16)), bytes(range(16, 32))
NUMBER = number_of(ID)


class Robot:
    """A session, and the robot's side of it."""

    def __init__(self, framing: str = "terminator", *, connected: bool = True, rate: str = "") -> None:
        self.config = fleet(
            (
                'interpreter: {connect: "127.0.0.1:1025"}',
                f'interpreter: {{connect: "127.0.0.1:1025", framing: {framing}}}',
            ),
            ("y: {type: Double}}}", f"y: {{type: Double}}}}{rate}}}"),
        )
        bridge = self.config.bridges["cell"]
        assert isinstance(bridge, TcpBridgeConfig)
        assert isinstance(bridge.interpreter, InterpreterLink)
        self.told: list[DriverEvent] = []
        self.sent: list[bytes] = []
        self.resets: list[str] = []
        self.offences: list[str] = []
        self.now = 0.0
        self.takes = True
        sources = configured_sources(self.config, "cell", TcpSource, TcpSource())
        sources = tuple([data for data in sources if subtype_of(data) == "position"])
        self.session = InterpreterSession(
            bridge.interpreter,
            [*sources, *faults_of(self.config, "cell")],
            self.told.append,
            self._write,
            self._reset,
            self._misbehaves,
            self.now,
        )
        skills = configured_skills(self.config, "cell", TcpSkillMapping)
        self.skill: TcpSkill = next(skill for skill in skills if skill.name == "work")
        if connected:
            self.session.connected(self.now)

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

    def says(self, *fields: str) -> None:
        self.session.received("".join(f"{field}\n" for field in fields).encode(), self.now, 5)
        self.session.turn(self.now)

    def reads(self) -> list[list[str]]:
        """The messages sent since the last call."""
        fields = b"".join(self.sent).decode().split("\n")[:-1]
        self.sent.clear()
        messages: list[list[str]] = []
        while fields:
            end = 4 + int(fields[3])
            messages.append(fields[:end])
            fields = fields[end:]
        return messages

    def execute(self, what: str = "weld", execution_id: bytes = ID) -> Execution:
        execution = Execution(execution_id, self.skill.topic, 1, (what, 0.5), 10.0)
        self.session.execute(self.skill, execution, self.now)
        return execution

    def facts(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.told if isinstance(event, kind)]

    def drops(self, cause: Drop) -> int:
        return sum(event.cause is cause for event in self.told if isinstance(event, Dropped))


def test_a_skill_from_the_command_to_its_results() -> None:
    robot = Robot()
    robot.execute()
    assert robot.reads() == [["command", "work", str(NUMBER), "2", "weld", "0.5"]]
    robot.says("status", "running", str(NUMBER), "1", "0.25")
    assert robot.facts(ExecutionProgressed) == [ExecutionProgressed(ID, 0.25, "")]
    robot.says("status", "done", str(NUMBER), "2", "weld", "0.5")
    assert robot.facts(ExecutionEnded) == [ExecutionEnded(ID, 0, ("weld", 0.5), "")]
    assert robot.session.turn(robot.now) is None
    robot.says("status", "done", str(NUMBER), "2", "weld", "0.5")
    assert len(robot.facts(ExecutionEnded)) == 1
    assert robot.drops(Drop.UNASKED) == 1


@pytest.mark.parametrize(
    ("said", "status", "message"),
    [
        (("failed", "1", "stuck"), StatusCode.BAD_UNEXPECTED_ERROR, "stuck"),
        (("failed", "0"), StatusCode.BAD_UNEXPECTED_ERROR, "the robot says so"),
        (("refused", "1", "no tool"), StatusCode.BAD_REQUEST_NOT_ALLOWED, "no tool"),
        (("busy", "0"), StatusCode.BAD_TOO_MANY_OPERATIONS, "the robot is at another"),
        (("halted", "0"), StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, "it was halted"),
        (("done", "1", "weld"), StatusCode.UNCERTAIN, "its result seconds is not known: it is missing"),
        (("done", "2", "weld", "x"), StatusCode.UNCERTAIN, "its result seconds is not known"),
    ],
)
def test_other_ends(said: tuple[str, ...], status: StatusCode, message: str) -> None:
    robot = Robot()
    robot.execute()
    state, *rest = said
    robot.says("status", state, str(NUMBER), *rest)
    (ended,) = robot.facts(ExecutionEnded)
    assert ended.status == status
    assert message in ended.message


def test_silence_is_asked_about_and_never_told_again() -> None:
    robot = Robot()
    robot.execute()
    robot.reads()
    robot.after(2.0)
    assert robot.reads() == [["query", "work", str(NUMBER), "0"]]
    robot.says("status", "running", str(NUMBER), "0")
    robot.after(4.9)
    assert robot.reads() == []
    robot.after(0.2)
    assert robot.reads() == [["query", "work", str(NUMBER), "0"]]


def test_a_program_that_never_answers_leaves_it_unknown() -> None:
    robot = Robot()
    robot.execute()
    robot.after(10.0)
    (forgotten,) = robot.facts(ExecutionForgotten)
    assert "never answered" in forgotten.message
    assert robot.reads()[-1][0] == "halt"


def test_one_that_takes_too_long_is_stopped() -> None:
    robot = Robot()
    robot.execute()
    robot.says("status", "running", str(NUMBER), "0")
    robot.reads()
    robot.after(10.0)
    (ended,) = robot.facts(ExecutionEnded)
    assert (ended.status, ended.message) == (StatusCode.BAD_TIMEOUT, "it took longer than 10 s; it was told to stop")
    assert robot.reads() == [["halt", "work", str(NUMBER), "0"]]


@pytest.mark.parametrize("answer", ["running", "unknown", "never", "done"])
def test_after_a_lost_connection_the_number_is_asked_for(answer: str) -> None:
    robot = Robot()
    robot.execute()
    command = robot.reads()[0]
    robot.session.lost(robot.now)
    robot.now += 1
    robot.session.connected(robot.now)
    assert robot.reads() == [["query", "work", str(NUMBER), "0"]]
    robot.says("status", answer, str(NUMBER), *(("2", "weld", "0.5") if answer == "done" else ("0",)))
    assert robot.reads() == ([command] if answer == "never" else [])
    assert len(robot.facts(ExecutionForgotten)) == (answer == "unknown")
    assert len(robot.facts(ExecutionEnded)) == (answer == "done")


@pytest.mark.parametrize("answer", ["never", "unknown", "done"])
def test_a_bridge_that_comes_later_asks(answer: str) -> None:
    robot = Robot()
    robot.session.query(robot.skill, Execution(ID, robot.skill.topic, 1, ("weld", 0.5), 10.0), robot.now)
    assert robot.reads() == [["query", "work", str(NUMBER), "0"]]
    robot.says("status", answer, str(NUMBER), *(("2", "weld", "0.5") if answer == "done" else ("0",)))
    wanted = {"never": ExecutionNotBegun, "unknown": ExecutionForgotten, "done": ExecutionEnded}[answer]
    assert len(robot.facts(wanted)) == 1
    assert robot.reads() == []


def test_what_is_begun_before_the_robot_is_there_waits_for_it() -> None:
    robot = Robot(connected=False)
    robot.execute()
    assert robot.sent == []
    robot.now = 1.0
    robot.session.connected(robot.now)
    assert [message[0] for message in robot.reads()] == ["command"]


def test_but_not_for_long() -> None:
    robot = Robot(connected=False)
    robot.execute()
    assert robot.session.turn(robot.now) == 3.0
    robot.after(3.0)
    assert robot.facts(ExecutionEnded)[0].status == StatusCode.BAD_NO_COMMUNICATION
    with pytest.raises(RobotOffline, match="start it"):
        robot.execute(execution_id=OTHER)
    robot.session.connected(robot.now)
    assert robot.sent == []


def test_halting() -> None:
    robot = Robot()
    execution = robot.execute()
    robot.reads()
    robot.session.halt(execution, robot.now)
    assert robot.reads() == [["halt", "work", str(NUMBER), "0"]]
    waiting = Robot(connected=False)
    waiting.session.halt(waiting.execute(), 0.0)
    assert waiting.facts(ExecutionEnded)[0].status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT


def test_an_argument_that_is_no_field_is_refused_and_nothing_sent() -> None:
    robot = Robot()
    with pytest.raises(SkillRejected, match="control characters"):
        robot.execute("a\nb")
    assert robot.sent == []
    assert robot.session.turn(robot.now) is None


def test_information_and_what_is_wrong_with_it() -> None:
    robot = Robot()
    position, fault = robot.facts(SourceFound)
    assert (position.name, fault.name) == ("arm.position", "arm.fault")
    robot.says("information", "position", "0", "2", "1.5", "x")
    bad = Variant(BuiltinType.STATUS_CODE, StatusCode.BAD_TYPE_MISMATCH)
    assert robot.facts(SampleRead) == [SampleRead(position.topic, (1.5, bad), 5)]
    robot.says("information", "position", "0", "2", "1.5", "x")
    robot.says("information", "height", "0", "1", "1")
    robot.says("information", "fault", "0", "1", "no air")
    robot.says("information", "fault", "0", "0")
    assert [sample.values for sample in robot.facts(SampleRead)[2:]] == [("no air",), ("",)]
    assert (robot.drops(Drop.CONVERSION), robot.drops(Drop.UNKNOWN_SOURCE)) == (2, 1)
    details = [event.detail for event in robot.facts(Dropped) if event.detail]
    assert len(details) == 2
    robot.session.lost(robot.now)
    assert len(robot.facts(SourceLost)) == 2


def test_a_robot_asks_for_anothers_data() -> None:
    robot = Robot()
    known: dict[str, tuple[Any, ...] | None] = {"other.temperature": None}
    robot.session.answer_from(known)
    robot.says("request", "other.temperature", "7", "0")
    known["other.temperature"] = (21.5,)
    robot.says("request", "other.temperature", "8", "0")
    robot.says("request", "other.secret", "9", "0")
    known["other.temperature"] = ("a\nb",)
    robot.says("request", "other.temperature", "10", "0")
    assert robot.reads() == [
        ["information", "other.temperature", "7", "0"],
        ["information", "other.temperature", "8", "1", "21.5"],
        ["information", "other.secret", "9", "0"],
        ["information", "other.temperature", "10", "0"],
    ]
    assert (robot.drops(Drop.UNKNOWN_SOURCE), robot.drops(Drop.CONVERSION)) == (1, 1)


@pytest.mark.parametrize("framing", ["terminator", "acknowledged"])
def test_a_value_for_a_connection_that_has_just_broken_is_dropped(framing: str) -> None:
    robot = Robot(framing)
    sinks = configured_sinks(robot.config, "cell", TcpSink, TcpSink())
    robot.takes = False
    assert not robot.session.inform(next(data for data in sinks if subtype_of(data) == "text"), ("hello",), robot.now)
    assert robot.drops(Drop.NOT_CONNECTED) == 1


def test_the_server_informs_the_robot() -> None:
    robot = Robot()
    sinks = configured_sinks(robot.config, "cell", TcpSink, TcpSink())
    text = next(data for data in sinks if subtype_of(data) == "text")
    assert robot.session.inform(text, ("hello",), robot.now)
    assert robot.reads() == [["information", "text", "0", "1", "hello"]]
    assert not robot.session.inform(text, ("a\x07",), robot.now)
    robot.session.lost(robot.now)
    assert not robot.session.inform(text, ("hello",), robot.now)
    assert (robot.drops(Drop.CONVERSION), robot.drops(Drop.NOT_CONNECTED)) == (1, 1)


@pytest.mark.parametrize("said", [b"bla\n", b"status\ndone\nx\n", b"\xff\xfe\n", b"x" * 1000])
def test_rubbish_ends_the_connection(said: bytes) -> None:
    robot = Robot()
    robot.session.received(said, robot.now, 5)
    assert len(robot.offences) == 1
    assert robot.drops(Drop.MALFORMED) == 1


@pytest.mark.parametrize("said", [b"stat", b"status\n", b"status\ndone\n5\n2\na\n"])
def test_a_program_that_stops_within_a_message_is_left(said: bytes) -> None:
    robot = Robot()
    robot.session.received(said, robot.now, 5)
    robot.after(0.0)
    robot.after(1.9)
    assert robot.offences == []
    robot.after(0.1)
    assert "in the middle of a message" in robot.offences[0]
    robot.session.connected(robot.now)
    robot.says("information", "position", "0", "2", "1", "2")
    assert robot.facts(SampleRead)[-1].values == (1.0, 2.0)


def test_a_program_that_streams_without_a_gap_is_not_left() -> None:
    robot = Robot()
    stream = b"information\nposition\n0\n2\n1\n2\n" * 200
    for start in range(0, len(stream), 47):  # nearly each reading ends within a message
        robot.session.received(stream[start : start + 47], robot.now, 5)
        robot.after(0.1)
    assert robot.now > 10.0
    assert robot.resets == []
    assert len(robot.facts(SampleRead)) == 200


def test_time_that_the_bridge_takes_for_many_messages_is_not_the_programs() -> None:
    """On a busy machine one reading of 64 KiB took longer than `answer_timeout_s`, and an honest program was left."""
    robot = Robot()
    robot.session.received(b"information\nposition\n0\n2\n1\n2\n" * 2000 + b"information\npos", robot.now, 5)
    robot.after(5.0)
    robot.after(1.9)
    assert robot.offences == []
    robot.after(0.1)
    assert "in the middle of a message" in robot.offences[0]


def test_acknowledged_fields_go_one_after_the_other() -> None:
    robot = Robot("acknowledged")
    robot.execute()
    expected = [b"command", b"work", str(NUMBER).encode(), b"2", b"weld", b"0.5"]
    for index in range(len(expected)):
        assert robot.sent == expected[: index + 1]
        robot.says("ack")
    assert robot.sent == expected
    robot.says("ack")
    assert robot.drops(Drop.UNASKED) == 1


def test_a_message_of_the_robot_between_acknowledgements() -> None:
    robot = Robot("acknowledged")
    robot.execute()
    robot.says("information", "position", "0", "2", "1", "2", "ack")
    assert len(robot.facts(SampleRead)) == 1
    assert robot.sent == [b"command", b"work"]


def test_a_field_that_is_not_acknowledged_ends_the_connection() -> None:
    robot = Robot("acknowledged")
    robot.execute()
    robot.after(2.0)
    assert "acknowledged no field" in robot.resets[0]
    robot.sent.clear()
    robot.session.connected(robot.now)
    assert robot.sent == [b"query"]


def test_of_values_that_wait_the_latest_counts() -> None:
    robot = Robot("acknowledged")
    sinks = configured_sinks(robot.config, "cell", TcpSink, TcpSink())
    text = next(data for data in sinks if subtype_of(data) == "text")
    for number in range(500):
        assert robot.session.inform(text, (str(number),), robot.now)
    assert robot.resets == []
    for _ in range(9):
        robot.says("ack")
    assert robot.sent == [b"information", b"text", b"0", b"1", b"0", b"information", b"text", b"0", b"1", b"499"]


def test_never_over_the_connection_that_had_the_command_is_no_answer() -> None:
    robot = Robot()
    robot.execute()
    for _ in range(7):
        robot.after(1.2)  # it stands still, and is asked again and again
    assert [message[0] for message in robot.reads()] == ["command", *["query"] * 3]
    for _ in range(100):
        robot.says("status", "never", str(NUMBER), "0")
    (forgotten,) = robot.facts(ExecutionForgotten)
    assert "over this connection" in forgotten.message
    assert robot.drops(Drop.MALFORMED) == 1
    robot.after(10.0)
    assert robot.reads() == []


@pytest.mark.parametrize("is_lost", [True, False])
def test_never_after_running_is_not_believed(is_lost: bool) -> None:
    robot = Robot()
    robot.execute()
    robot.says("status", "running", str(NUMBER), "0")
    robot.reads()
    if is_lost:
        robot.session.lost(robot.now)
        robot.now += 1
        robot.session.connected(robot.now)
    else:
        robot.after(5.0)
    assert [message[0] for message in robot.reads()] == ["query"]
    robot.says("status", "never", str(NUMBER), "0")
    (forgotten,) = robot.facts(ExecutionForgotten)
    assert "was at it" in forgotten.message
    assert robot.drops(Drop.MALFORMED) == 1
    assert robot.reads() == []


def test_answers_to_questions_before_the_command_do_not_count_against_it() -> None:
    robot = Robot()
    robot.execute()
    robot.session.lost(robot.now)
    robot.session.connected(robot.now)
    robot.after(2.0)
    robot.after(2.0)
    assert [message[0] for message in robot.reads()] == ["command", "query", "query", "query"]
    for _ in range(3):
        robot.says("status", "never", str(NUMBER), "0")
    assert [message[0] for message in robot.reads()] == ["command"]
    assert robot.facts(ExecutionForgotten) == []
    robot.says("status", "never", str(NUMBER), "0")
    assert len(robot.facts(ExecutionForgotten)) == 1
    assert robot.reads() == []


def test_a_program_that_asks_without_end_and_reads_nothing_is_left_and_met_again() -> None:
    robot = Robot("acknowledged")
    robot.says(*("request", "other.temperature", "1", "0") * 500)
    assert len(robot.resets) == 1
    robot.sent.clear()
    robot.session.connected(robot.now)
    robot.execute()
    assert robot.sent == [b"command"]
    robot.after(1.9)
    assert len(robot.resets) == 1


def test_a_source_has_its_rate() -> None:
    robot = Robot(rate=", source: {max_rate_hz: 2}")
    for number in range(10):
        robot.says("information", "position", "0", "2", str(number), "0")
    robot.after(0.4)
    assert [sample.values[0] for sample in robot.facts(SampleRead)] == [0.0]
    robot.after(0.1)
    assert [sample.values[0] for sample in robot.facts(SampleRead)] == [0.0, 9.0]
    assert robot.drops(Drop.RATE_LIMITED) == 8
    robot.says("information", "position", "0", "2", "10", "0")
    assert robot.session.turn(robot.now) == pytest.approx(1.0)
    robot.session.lost(robot.now)
    assert [sample.values[0] for sample in robot.facts(SampleRead)] == [0.0, 9.0, 10.0]
    assert isinstance(robot.told[-1], SourceLost)
