# pyright: basic, reportMissingImports=false, reportCallIssue=false, reportAttributeAccessIssue=false
# (pyright finds the std_msgs of ROS 2)
from __future__ import annotations

import contextlib
import queue
import socket
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

pytest.importorskip("rospy", reason="needs the Python that has rospy")

import rosgraph.network
from actionlib.msg import TestActionFeedback as ActionFeedback
from actionlib.msg import TestActionResult as ActionResult
from actionlib_msgs.msg import GoalID, GoalStatus, GoalStatusArray  # type: ignore[import-not-found]  # not in a wheel
from std_srvs.srv import SetBool
from ua_bridges.ros.ports import Listened, LoadedType
from ua_bridges.ros.skills import ActionSkill, RosSkillMapping, ServiceSkill, SkillSpec
from ua_bridges.ros.topic_mapping import QosConfig
from ua_bridges.ros1.classes import TypeUnavailable, needed_service, needed_type
from ua_bridges.ros1.master import RosMaster, SystemState
from ua_bridges.ros1.skills.action import Ros1ActionPort
from ua_bridges.ros1.skills.exchange import CallFailed, CallLost, NotAsked, exchange
from ua_bridges.ros1.skills.feed import MOST_WAITING, MOST_WAITING_BYTES, SkillFeed
from ua_bridges.ros1.skills.graph import Ros1Graph, ros1_name
from ua_bridges.ros1.skills.service import Ros1ServicePort

from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    Execution,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionProgressed,
)
from ua_fleet.bridge.executing import Executing
from ua_fleet.config.schema import SkillConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import SkillRejected
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

ID = bytes(range(16))


class Spoken:
    def __init__(self) -> None:
        self.said: list[Any] = []
        self.absent = ""

    def look(self, now: float) -> str:
        return self.absent

    def publish(self, message: Any) -> None:
        self.said.append(message)


class Graph:
    """What an action port sees of the ROS 1 graph."""

    def __init__(self) -> None:
        self.topics: dict[str, Spoken] = {}

    def load(self, ros_type: str) -> LoadedType:
        kind = needed_type(ros_type)
        return LoadedType(kind.cls, kind.schema)

    def speak(self, name: str, ros_type: str, qos: Any) -> Spoken:
        return self.topics.setdefault(name, Spoken())


class Acting:
    """An action port whose server is the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **via: Any) -> None:
        self.now = 100.0
        monkeypatch.setattr("ua_bridges.ros1.skills.action.time.monotonic", lambda: self.now)
        self.events: list[DriverEvent] = []
        raw = {"action": {"name": "/count", "type": "actionlib/Test", "fields": {"n": "goal"}, **via}}
        raw["action"].setdefault("results", {"counted": "result"})
        results = {"counted": {"type": "Int32"}} if raw["action"]["results"] else {}
        config = SkillConfig.model_validate(
            {"id": 5, "arguments": {"n": {"type": "Int32"}}, "results": results, "timeout_s": 30.0, "via": raw}
        )
        mapping = RosSkillMapping.model_validate(raw)
        spec = SkillSpec("arm", "count", Topic(1, 2, 5), Topic(1, 2, 6), config, mapping)
        self.executing = Executing(self.events.append)
        assert isinstance(mapping.way, ActionSkill)
        self.port = Ros1ActionPort(spec, mapping.way, self.executing, self.events.append)
        self.graph = Graph()
        self.port.opened(self.graph)  # type: ignore[arg-type]  # what a port of actions uses of it
        assert self.port.problem == ""
        self.heard = {listened.name: listened for listened in self.port.listened()}
        for listened in self.heard.values():
            listened.source("")
        self.port.turn(self.now)

    def execution(self, n: int = 3) -> Execution:
        return Execution(ID, Topic(1, 2, 5), 1, (n,))

    def begin(self, n: int = 3) -> None:
        execution = self.execution(n)
        self.port.begin(execution, self.port.prepare(execution), self.now)

    def status(self, *statuses: tuple[bytes, int, str]) -> None:
        array = [GoalStatus(GoalID(id=each.hex()), status, text) for each, status, text in statuses]
        self.heard["/count/status"].heard(GoalStatusArray(status_list=array))

    def result(self, status: int, value: int = 0, text: str = "", goal: bytes = ID) -> None:
        message = ActionResult()
        message.status = GoalStatus(GoalID(id=goal.hex()), status, text)
        message.result.result = value
        self.heard["/count/result"].heard(message)

    def later(self, seconds: float) -> None:
        self.now += seconds
        self.port.turn(self.now)

    def take(self) -> list[DriverEvent]:
        events = list(self.events)
        self.events.clear()
        return events


@pytest.fixture
def acting(monkeypatch: pytest.MonkeyPatch) -> Acting:
    return Acting(monkeypatch)


def test_goal_has_the_id_of_its_execution_and_ends_with_its_result(acting: Acting) -> None:
    acting.begin()
    (goal,) = acting.graph.topics["/count/goal"].said
    assert (goal.goal_id.id, goal.goal.goal) == (ID.hex(), 3)
    acting.status((ID, GoalStatus.ACTIVE, ""))
    acting.status((ID, GoalStatus.ACTIVE, ""))
    acting.status((ID, GoalStatus.SUCCEEDED, ""))
    acting.result(GoalStatus.SUCCEEDED, 7, "counted")
    assert acting.take() == [ExecutionProgressed(ID), ExecutionEnded(ID, 0, (7,), "counted")]
    acting.later(10)
    assert acting.take() == []


def test_second_answer_is_counted_and_another_clients_is_not(acting: Acting) -> None:
    acting.begin()
    acting.result(GoalStatus.SUCCEEDED, 7)
    acting.take()
    acting.result(GoalStatus.SUCCEEDED, 8)
    (dropped,) = acting.take()
    assert isinstance(dropped, Dropped)
    assert dropped.cause is Drop.UNASKED
    acting.result(GoalStatus.SUCCEEDED, 8, goal=b"another client's")
    assert acting.take() == []


@pytest.mark.parametrize(
    ("status", "text", "code", "message"),
    [
        (GoalStatus.ABORTED, "stuck", StatusCode.BAD_UNEXPECTED_ERROR, "stuck"),
        (GoalStatus.REJECTED, "", StatusCode.BAD_REQUEST_NOT_ALLOWED, "the action server refused the goal"),
        (GoalStatus.PREEMPTED, "", StatusCode.BAD_UNEXPECTED_ERROR, "another goal took its place"),
    ],
)
def test_goal_that_does_not_succeed(acting: Acting, status: int, text: str, code: int, message: str) -> None:
    acting.begin()
    acting.result(status, 0, text)
    assert acting.take() == [ExecutionEnded(ID, code, (), message)]


def test_canceled_goal_is_halted(acting: Acting) -> None:
    acting.begin()
    acting.port.cancel(ID, acting.now)
    (cancel,) = acting.graph.topics["/count/cancel"].said
    assert (cancel.id, cancel.stamp.to_nsec()) == (ID.hex(), 0)  # with a stamp, older goals would be canceled too
    acting.result(GoalStatus.PREEMPTED)
    assert acting.take() == [ExecutionEnded(ID, StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT, (), "it was halted")]


def test_halted_goal_is_canceled_when_its_server_is_there_and_until_it_ends(acting: Acting) -> None:
    acting.begin()
    cancel = acting.graph.topics["/count/cancel"]
    cancel.absent = "/count/cancel has no subscriber; start the robot's node"
    acting.port.cancel(ID, acting.now)
    acting.later(5.0)
    assert cancel.said == []
    cancel.absent = ""
    for seconds in (0.2, 0.2, 0.5, 0.5):
        acting.later(seconds)
    acting.port.cancel(ID, acting.now)
    assert len(cancel.said) == 2, "once a second"
    acting.result(GoalStatus.PREEMPTED)
    acting.later(5.0)
    assert len(cancel.said) == 2


def test_overdue_goal_that_could_not_be_canceled_says_so(acting: Acting) -> None:
    acting.begin()
    acting.status((ID, GoalStatus.ACTIVE, ""))
    acting.graph.topics["/count/cancel"].absent = "/count/cancel has no subscriber; start the robot's node"
    acting.now += 31
    for opened in acting.executing.overdue(acting.now):
        acting.port.overdue(opened, acting.now)
    acting.take()
    acting.later(2.5)
    (ended,) = acting.take()
    assert isinstance(ended, ExecutionEnded)
    assert "it could not be told to stop: /count/cancel has no subscriber" in ended.message


def test_overdue_goal_is_canceled_and_given_up(acting: Acting) -> None:
    acting.begin()
    acting.status((ID, GoalStatus.ACTIVE, ""))
    acting.now += 31
    for opened in acting.executing.overdue(acting.now):
        acting.port.overdue(opened, acting.now)
    assert len(acting.graph.topics["/count/cancel"].said) == 1
    acting.take()
    acting.later(1.0)
    assert acting.take() == []
    acting.later(1.5)
    (ended,) = acting.take()
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == StatusCode.BAD_TIMEOUT


def test_goal_that_the_server_does_not_know_is_forgotten_and_never_sent_again(acting: Acting) -> None:
    acting.begin()
    acting.status()
    acting.later(1.9)
    acting.status()
    assert acting.take() == []
    acting.later(0.2)
    acting.status((b"another client's", GoalStatus.ACTIVE, ""))
    assert acting.take() == [ExecutionForgotten(ID, "the server of /count knows no such goal")]
    assert len(acting.graph.topics["/count/goal"].said) == 1


def test_restarted_server_no_longer_knows_the_goal(acting: Acting) -> None:
    acting.begin()
    acting.status((ID, GoalStatus.ACTIVE, ""))
    acting.status()
    acting.later(2.1)
    acting.status()
    assert isinstance(acting.take()[-1], ExecutionForgotten)


def test_asked_goal_sends_nothing_and_goes_on(acting: Acting) -> None:
    acting.port.query(acting.execution(), acting.now)
    acting.status((ID, GoalStatus.ACTIVE, ""))
    acting.result(GoalStatus.SUCCEEDED, 3)
    assert acting.take() == [ExecutionProgressed(ID), ExecutionEnded(ID, 0, (3,), "")]
    assert acting.graph.topics["/count/goal"].said == []


@pytest.mark.parametrize(
    ("via", "fact"),
    [
        (
            {},
            ExecutionEnded(
                ID, StatusCode.UNCERTAIN, (), "it is done; its results came while the bridge was not connected"
            ),
        ),
        ({"results": {}}, ExecutionEnded(ID)),
        (
            {"success": "result > 0"},
            ExecutionForgotten(ID, "it ended while the bridge was not connected, and its result is not known"),
        ),
    ],
)
def test_goal_that_ended_before_it_is_asked(
    monkeypatch: pytest.MonkeyPatch, via: dict[str, Any], fact: DriverEvent
) -> None:
    acting = Acting(monkeypatch, **via)
    acting.port.query(acting.execution(), acting.now)
    acting.status((ID, GoalStatus.SUCCEEDED, ""))
    acting.later(1.9)
    assert acting.take() == []
    acting.later(0.2)
    assert acting.take() == [fact]


def test_feedback_is_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    acting = Acting(monkeypatch, progress="feedback / arguments.n")
    acting.begin(4)
    feedback = ActionFeedback()
    feedback.status.goal_id.id = ID.hex()
    feedback.feedback.feedback = 1
    acting.heard["/count/feedback"].heard(feedback)
    assert acting.take() == [ExecutionProgressed(ID, 0.25)]


def test_argument_that_does_not_fit_is_refused(acting: Acting) -> None:
    with pytest.raises(SkillRejected, match="the robot's message cannot hold that"):
        acting.port.prepare(acting.execution(1 << 40))


def test_missing_types_name_their_package() -> None:
    with pytest.raises(
        TypeUnavailable, match="service type kitchen_msgs/Cook is not installed; install python3-kitchen-msgs"
    ):
        needed_service("kitchen_msgs/Cook")
    assert needed_service("std_srvs/SetBool") is SetBool
    assert ros1_name("move_base_msgs/action/MoveBase") == "move_base_msgs/MoveBase"


class Server:
    """One connection of a service."""

    def __init__(self, serve: Callable[[socket.socket], None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.uri = f"rosrpc://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._run, args=(serve,))
        self._thread.start()

    def _run(self, serve: Callable[[socket.socket], None]) -> None:
        link, _ = self._listener.accept()
        with link:
            link.settimeout(5)
            link.recv(4096)
            serve(link)

    def call(self) -> Any:
        """Call it, and end it."""
        self.asked = 0

        def asked() -> None:
            self.asked += 1

        try:
            return exchange(self.uri, "/hold", SetBool, "/ua_bridge", b"\x01", lambda link: None, asked)
        finally:
            self.end()

    def end(self) -> None:
        """Its one connection has ended."""
        self._thread.join()
        self._listener.close()


def _accept(link: socket.socket) -> None:
    link.sendall(rosgraph.network.encode_ros_handshake_header({"callerid": "/robot", "md5sum": "x"}))
    link.recv(4096)


def test_service_answers() -> None:
    def serve(link: socket.socket) -> None:
        _accept(link)
        content = b"\x01" + struct.pack("<I", 4) + b"held"
        for part in (b"\x01" + struct.pack("<I", len(content)), content[:3], content[3:]):
            link.sendall(part)

    server = Server(serve)
    response = server.call()
    assert (response.success, response.message, server.asked) == (True, "held", 1)


def test_service_that_fails_says_why() -> None:
    def serve(link: socket.socket) -> None:
        _accept(link)
        link.sendall(b"\x00" + struct.pack("<I", 5) + b"stuck")

    with pytest.raises(CallFailed, match="stuck"):
        Server(serve).call()


def test_service_of_another_type_was_not_asked() -> None:
    def serve(link: socket.socket) -> None:
        link.sendall(rosgraph.network.encode_ros_handshake_header({"error": "md5sums do not match"}))

    server = Server(serve)
    with pytest.raises(NotAsked, match="refused the call: md5sums do not match") as refused:
        server.call()
    assert refused.value.status == StatusCode.BAD_TYPE_MISMATCH
    assert server.asked == 0


def test_service_that_is_gone_was_not_asked() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        uri = f"rosrpc://127.0.0.1:{probe.getsockname()[1]}"
    with pytest.raises(NotAsked, match="does not answer"):
        exchange(uri, "/hold", SetBool, "/ua_bridge", b"\x01", lambda link: None, lambda: None)


@pytest.mark.parametrize(
    ("said", "pause_s"),
    [(b"\xff\xff\xff\xff" + b"x" * 65536, 0.0), (struct.pack("<I", 60_000) + b"x", 0.1), (b"\0\1\0\0", 0.0)],
    ids=["endless", "slow", "silent"],
)
def test_a_handshake_without_an_end_ends(monkeypatch: pytest.MonkeyPatch, said: bytes, pause_s: float) -> None:
    monkeypatch.setattr("ua_bridges.ros1.skills.exchange.CONNECT_S", 0.5)

    def serve(link: socket.socket) -> None:
        with contextlib.suppress(OSError):
            link.sendall(said[:4])
            while said[4:]:
                link.sendall(said[4:])
                time.sleep(pause_s)
            link.recv(1)

    server = Server(serve)
    with pytest.raises(NotAsked, match="its connection header"):
        server.call()
    assert server.asked == 0


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (b"", "went before it answered"),
        (b"\x01\x05\x00", "went before it answered"),
        (b"\x01\xff\xff\xff\xff", "at most"),
        (b"\x01\x01\x00\x00\x00\x01", "cannot be read"),
    ],
)
def test_nobody_knows_what_a_service_did_that_was_asked_and_did_not_answer(said: bytes, why: str) -> None:
    def serve(link: socket.socket) -> None:
        _accept(link)
        link.sendall(said)

    server = Server(serve)
    with pytest.raises(CallLost, match=why):
        server.call()
    assert server.asked == 1


def test_call_that_is_given_up_ends() -> None:
    links: list[socket.socket] = []
    began = threading.Event()

    def serve(link: socket.socket) -> None:
        _accept(link)
        began.set()
        link.recv(1)  # until the caller goes

    def end() -> None:
        began.wait(5)
        links[0].shutdown(socket.SHUT_RDWR)

    server = Server(serve)
    ending = threading.Thread(target=end)
    ending.start()
    with pytest.raises(CallLost):
        exchange(server.uri, "/hold", SetBool, "/ua_bridge", b"\x01", links.append, lambda: None)
    ending.join()
    server.end()


class Calling:
    """A service port whose server, and whose thread, is the test."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, uri: str) -> None:
        raw = {"service": {"name": "/hold", "type": "std_srvs/SetBool", "success": "success", "message": "message"}}
        config = SkillConfig.model_validate(
            {"id": 5, "arguments": {"data": {"type": "Boolean"}}, "timeout_s": 1.0, "via": raw}
        )
        mapping = RosSkillMapping.model_validate(raw)
        assert isinstance(mapping.way, ServiceSkill)
        self.events: list[DriverEvent] = []
        self._steps: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        state = SystemState({}, {}, {"/hold": ["/robot"]})
        graph = Ros1Graph("/ua_bridge", "http://127.0.0.1:1", lambda: state, self._steps.put, self.events.append)
        spec = SkillSpec("arm", "hold", Topic(1, 2, 5), Topic(1, 2, 6), config, mapping)
        self.executing = Executing(self.events.append)
        self.port = Ros1ServicePort(spec, mapping.way, self.executing, self.events.append)
        self.port.opened(graph)
        self.port.turn(0.0)
        monkeypatch.setattr(RosMaster, "service_uri", lambda _master, _name: uri)
        execution = Execution(ID, Topic(1, 2, 5), 1, (True,))
        self.port.begin(execution, self.port.prepare(execution), 0.0)

    def step(self) -> None:
        """Do what a call's thread has brought."""
        self._steps.get(timeout=5)()


def _answer(link: socket.socket, message: bytes = b"held") -> None:
    content = b"\x01" + struct.pack("<I", len(message)) + message
    link.sendall(b"\x01" + struct.pack("<I", len(content)) + content)


def test_service_that_answers_after_its_time_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    is_late = threading.Event()

    def serve(link: socket.socket) -> None:
        _accept(link)
        is_late.wait(5)
        _answer(link)

    server = Server(serve)
    calling = Calling(monkeypatch, server.uri)
    calling.step()
    (opened,) = calling.executing.overdue(2.0)
    calling.port.overdue(opened, 2.0)
    is_late.set()
    calling.step()
    server.end()
    progressed, ended, dropped = calling.events
    assert progressed == ExecutionProgressed(ID)
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == StatusCode.BAD_TIMEOUT
    assert isinstance(dropped, Dropped)
    assert dropped.cause is Drop.UNASKED


def test_service_whose_server_dies_while_it_works_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    server = Server(_accept)
    calling = Calling(monkeypatch, server.uri)
    calling.step()
    calling.step()
    server.end()
    assert isinstance(calling.events[-1], ExecutionForgotten)
    assert "the server of /hold went before it answered" in calling.events[-1].message


def test_mistake_of_ours_in_a_call_is_told_as_an_execution_that_nobody_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    def mistaken(*_: Any) -> None:
        raise KeyError("x")

    monkeypatch.setattr("ua_bridges.ros1.skills.service.exchange", mistaken)
    calling = Calling(monkeypatch, "rosrpc://127.0.0.1:1")
    calling.step()
    assert isinstance(calling.events[-1], ExecutionForgotten)
    assert calling.events[-1].message == "a mistake of the bridge (KeyError('x')); see what the robot does"


def test_calls_end_when_the_bridge_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    def serve(link: socket.socket) -> None:
        _accept(link)
        link.recv(1)  # until the bridge goes

    server = Server(serve)
    calling = Calling(monkeypatch, server.uri)
    calling.step()
    calling.port.close()
    calling.step()
    server.end()


class Heard:
    """A topic that a skill hears."""

    def __init__(self) -> None:
        self.steps: list[Callable[[], None]] = []
        self.messages: list[str] = []
        self.drops: list[Any] = []
        topic = Listened("/words", "std_msgs/String", QosConfig(), self._hear, lambda _problem: None)
        self.feed = SkillFeed(topic, self.steps.append, self.drops.append)
        self.read = self.feed.reader(needed_type("std_msgs/String"))

    def _hear(self, message: Any) -> None:
        self.messages.append(message.data)

    def say(self, text: str) -> None:
        self.read(struct.pack("<I", len(text)) + text.encode(), 0, False)

    def work(self) -> None:
        for step in self.steps:
            step()
        self.steps.clear()


def test_a_topic_that_floods_a_skill_pushes_out_its_own_messages() -> None:
    heard = Heard()
    for number in range(MOST_WAITING + 500):
        heard.say(str(number))
    assert len(heard.steps) == MOST_WAITING
    heard.work()
    assert heard.messages == [str(number) for number in range(500, MOST_WAITING + 500)]
    assert sum(drop.count for drop in heard.drops) == 500
    assert {drop.cause for drop in heard.drops} == {Drop.INLET_FULL}


def test_large_messages_that_wait_for_a_skill_are_bounded_by_their_bytes() -> None:
    heard = Heard()
    for _ in range(3):
        for number in range(100):
            heard.say(str(number))
        heard.say("x" * (MOST_WAITING_BYTES + 1))
    assert len(heard.steps) <= 101
    heard.work()
    assert [len(message) for message in heard.messages] == [MOST_WAITING_BYTES + 1]
    assert sum(drop.count for drop in heard.drops) == 302
