"""Each message has the kind that the table says, whoever sends it."""

from collections.abc import Iterable

import pytest

from ua_fleet.counters import Counters
from ua_fleet.pubsub.carry_action import CARRY_ID, Word
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.run_data import RUN_DATA_ID
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.skill.status import SKILL_STATUS_FIELDS, ExecutionStatus, SkillStatus
from ua_fleet.topics import Topic
from ua_fleet.traffic import MessageKind, Traffic
from ua_fleet.values import BuiltinType
from ua_fleet.wire import ActionMessage, ActionState, Codec, encode_action, encode_announcement, encode_probe
from ua_fleet.wire.discovered import ActionTarget, PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, Probe, ProbeKind

SPACE = 7
STATUS = Topic(SPACE, 2, 101)
POSE = Topic(SPACE, 2, 102)
SKILL = Topic(SPACE, 2, 103)
WALL = 134_000_000_000_000_000
TIMING = PubSubTiming()
X = (make_field("x", BuiltinType.DOUBLE),)


class Robot:
    """A publisher, and what it says to a Traffic."""

    def __init__(self, known: dict[Topic, MessageKind] | None = None) -> None:
        self.traffic = Traffic(known)
        self.publisher = Publisher(SPACE, TIMING, Counters(), Codec())
        self.status = SkillStatus()

    def kinds(self, datagrams: Iterable[bytes], now: float = 0.0) -> list[MessageKind]:
        return [kind for datagram in datagrams for kind in self.traffic.take(datagram, len(datagram), now)]

    def announce_status(self) -> list[MessageKind]:
        return self.kinds(
            self.publisher.announce(STATUS, "robot skill status", SKILL_STATUS_FIELDS, now=0.0, wall_ticks=WALL)
        )

    def show(self, number: int, state: ExecutionState, timestamp: int) -> list[MessageKind]:
        self.status.show(ExecutionStatus(number.to_bytes(16), "task", state))
        types, values = self.status.fields()
        return self.kinds(self.publisher.publish(STATUS, values, timestamp=timestamp, now=0.0, types=types))


def test_who_comes_registers_and_then_is_alive() -> None:
    robot = Robot()
    assert robot.kinds(robot.publisher.begin(now=0.0, wall_ticks=WALL)) == [
        MessageKind.REGISTRATION,
        MessageKind.REGISTRATION,
    ]
    assert robot.kinds(robot.publisher.poll(10.0, WALL)) == [MessageKind.KEEP_ALIVE]
    assert robot.kinds(robot.publisher.poll(60.0, WALL)) == [
        MessageKind.KEEP_ALIVE,
        MessageKind.REPEAT,
    ]  # status, application
    assert robot.kinds(robot.publisher.end()) == [MessageKind.REGISTRATION]


def test_a_source_is_metadata_and_configuration() -> None:
    robot = Robot()
    robot.publisher.begin(now=0.0, wall_ticks=WALL)
    assert robot.announce_status() == [MessageKind.METADATA, MessageKind.KEEP_ALIVE]
    assert robot.kinds(robot.publisher.poll(0.5, WALL)) == [MessageKind.REGISTRATION]  # the WriterGroup
    asked = Probe(SPACE, 1, ProbeKind.DATA_SET_META_DATA, (STATUS.id,))
    assert robot.kinds([encode_probe(asked)]) == [MessageKind.METADATA]
    assert robot.kinds(robot.publisher.answer(asked, 5.0)) == [MessageKind.REPEAT, MessageKind.KEEP_ALIVE]


def test_other_metadata_than_before_is_no_repeat() -> None:
    robot = Robot()
    robot.kinds(robot.publisher.announce(POSE, "pose", X, now=0.0, wall_ticks=WALL))
    other = (*X, make_field("y", BuiltinType.DOUBLE))
    changed = robot.kinds(robot.publisher.announce(POSE, "pose", other, now=0.0, wall_ticks=WALL))
    assert changed == [MessageKind.METADATA, MessageKind.KEEP_ALIVE]


def test_an_action_and_its_responder_are_metadata() -> None:
    robot = Robot()
    target = (ActionTarget(1, "robot"),)
    said = robot.publisher.announce_action(SKILL, "task", target, X, (), now=0.0, wall_ticks=WALL)
    assert robot.kinds(said) == [MessageKind.METADATA]
    assert robot.kinds(robot.publisher.poll(0.5, WALL)) == []
    asked = Probe(SPACE, 1, ProbeKind.PUBSUB_CONNECTIONS)
    assert robot.kinds(robot.publisher.answer(asked, 1.0)) == [MessageKind.METADATA, MessageKind.METADATA]


def test_looking_for_applications_is_registration() -> None:
    robot = Robot()
    assert robot.kinds([encode_probe(Probe(None, 1, ProbeKind.FIND_APPLICATIONS))]) == [MessageKind.REGISTRATION]


@pytest.mark.parametrize(("is_request", "kind"), [(True, MessageKind.REQUEST), (False, MessageKind.RESPONSE)])
def test_actions(is_request: bool, kind: MessageKind) -> None:
    robot = Robot()
    message = ActionMessage(*SKILL, 1, 1, ActionState.DONE, is_request, "0.server", bytes(16))
    assert robot.kinds([encode_action(message)] * 2) == [kind, kind]  # asked again is asked
    both = message._replace(others=(message._replace(request_id=2),))
    assert robot.kinds([encode_action(both)]) == [kind, kind]


def test_status_tells_each_failure_once() -> None:
    robot = Robot()
    robot.announce_status()
    assert robot.show(1, ExecutionState.RUNNING, 1) == [MessageKind.STATUS]
    assert robot.show(1, ExecutionState.FAILED, 2) == [MessageKind.FAULT]
    assert robot.show(2, ExecutionState.RUNNING, 3) == [MessageKind.STATUS]  # it still shows the first one
    assert robot.show(2, ExecutionState.UNKNOWN, 4) == [MessageKind.FAULT]
    assert robot.kinds(robot.publisher.poll(TIMING.repeat_interval_s, WALL)) == [MessageKind.REPEAT]


def test_data_without_a_skill_status_s_metadata_is_telemetry() -> None:
    robot = Robot()
    robot.publisher.announce(STATUS, "robot skill status", SKILL_STATUS_FIELDS, now=0.0, wall_ticks=WALL)
    assert robot.show(1, ExecutionState.FAILED, 1) == [MessageKind.TELEMETRY]


def test_a_source_that_goes_is_a_fault() -> None:
    robot = Robot()
    robot.kinds(robot.publisher.announce(POSE, "pose", X, now=0.0, wall_ticks=WALL))
    assert robot.kinds(robot.publisher.publish(POSE, (1.0,), timestamp=5, now=0.0)) == [MessageKind.TELEMETRY]
    assert robot.kinds(robot.publisher.source_lost(POSE, timestamp=6, now=1.0)) == [MessageKind.FAULT]


def test_a_process_in_error_is_a_fault() -> None:
    robot = Robot()
    failed = StatusAnnouncement(SPACE, 1, 0, False, PubSubState.ERROR)
    assert robot.kinds([encode_announcement(failed)]) == [MessageKind.FAULT]


def test_the_owner_knows_sensors() -> None:
    robot = Robot({POSE: MessageKind.SENSOR})
    robot.kinds(robot.publisher.announce(POSE, "temperature", X, now=0.0, wall_ticks=WALL))
    assert robot.kinds(robot.publisher.publish(POSE, (20.5,), timestamp=5, now=0.0)) == [MessageKind.SENSOR]
    assert robot.kinds(robot.publisher.poll(TIMING.repeat_interval_s, WALL)) == [MessageKind.REPEAT]


def test_messages_of_one_datagram_share_its_bytes() -> None:
    alive = DataSetMessage(1, FrameKind.KEEP_ALIVE, sequence_number=1)
    data = DataSetMessage(2, types=(BuiltinType.DOUBLE,), values=(1.0,), sequence_number=1, timestamp=5)
    plain = Codec().encode(NetworkMessage(SPACE, writer_group_id=2, messages=(alive, data)))
    traffic = Traffic()
    assert traffic.take(plain, 101, 61.9) == [MessageKind.KEEP_ALIVE, MessageKind.TELEMETRY]
    assert traffic.bytes == {MessageKind.KEEP_ALIVE: 51, MessageKind.TELEMETRY: 50}
    assert traffic.bytes_at == {(61, MessageKind.KEEP_ALIVE): 51, (61, MessageKind.TELEMETRY): 50}
    assert traffic.messages_at == {(61, MessageKind.KEEP_ALIVE): 1, (61, MessageKind.TELEMETRY): 1}


def test_what_nobody_can_read_is_counted_apart() -> None:
    traffic = Traffic()
    assert traffic.take(b"\xff\xff\xff", 3, 0.0) == []
    assert traffic.unreadable == 1
    assert not traffic.messages


def test_words_of_carried_runs_are_tokens_and_what_the_server_asks_is_telemetry() -> None:
    traffic = Traffic()

    def said(word: int | None, *, is_request: bool = True, key: bytes = b"k" * 16) -> list[MessageKind]:
        types = (int(BuiltinType.BYTE), int(BuiltinType.BYTE_STRING)) if word is not None else ()
        values = (word, b"content") if word is not None else ()
        message = ActionMessage(
            300,
            2,
            CARRY_ID,
            1,
            1,
            ActionState.EXECUTING if word is not None else ActionState.IDLE,
            is_request=is_request,
            requestor_id="0.carried",
            correlation_data=key,
            types=types,
            values=values,
        )
        return traffic.take(encode_action(message), 100, 0.0)

    for word in (Word.PART, Word.TOKEN, Word.END):
        assert said(word, key=bytes([word] * 16)) == [MessageKind.TOKEN]
    assert said(Word.FETCH) == [MessageKind.TELEMETRY]
    assert said(None) == said(None, is_request=False) == [MessageKind.TELEMETRY]
    assert said(None, is_request=False, key=bytes([Word.TOKEN] * 16)) == [MessageKind.TOKEN]


def test_what_a_bridge_tells_of_its_runs_is_counted_apart() -> None:
    traffic = Traffic()
    told = DataSetMessage(
        RUN_DATA_ID, FrameKind.KEY, types=(int(BuiltinType.STRING),), values=("a run",), timestamp=WALL
    )
    message = NetworkMessage(300, writer_group_id=2, messages=(told,))
    assert traffic.take(Codec().encode(message), 100, 0.0) == [MessageKind.RUN]
    assert traffic.take(Codec().encode(message), 100, 5.0) == [MessageKind.REPEAT]
    assert (traffic.messages[MessageKind.RUN], traffic.bytes[MessageKind.RUN]) == (1, 100)


def test_an_answer_whose_request_was_not_seen_is_known_by_its_content() -> None:
    def answer(content: bytes) -> list[MessageKind]:
        types = (int(BuiltinType.BYTE), int(BuiltinType.STRING), int(BuiltinType.BYTE_STRING))
        message = ActionMessage(
            300,
            2,
            CARRY_ID,
            1,
            1,
            ActionState.DONE,
            is_request=False,
            requestor_id="0.carried",
            correlation_data=b"k" * 16,
            types=types,
            values=(ExecutionState.DONE.value, "", content),
        )
        return Traffic().take(encode_action(message), 100, 0.0)

    assert answer(b"") == [MessageKind.TOKEN]
    assert answer(b"facts") == [MessageKind.TELEMETRY]
