"""Replayed values: those that were told then, never as live, and no command among them."""

from __future__ import annotations

import pytest

from tests.unit.pubsub.publishing import CODEC, WALL, Reading, decoded, only
from tests.unit.recording.recorded import ARM, BEGUN_NS, LEG, SETPOINTS, Recording, action, keys, setpoint
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import DataReceived, MetaDataReceived, Publisher, PubSubTiming, make_field
from ua_fleet.pubsub.events import SubscriberEvent
from ua_fleet.pubsub.layout import WriterSettings
from ua_fleet.pubsub.metadata import NODE_ONLY, first_property
from ua_fleet.recording.opening import RecordedOpener
from ua_fleet.recording.playback import REPLAY_SPACE, Playback, Replay
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.wire import ActionMessage, SecurityMode
from ua_fleet.wire.messages import FieldEncoding, MetaDataAnnouncement, NetworkMessage

SUBSTITUTE = int(StatusCode.UNCERTAIN_SUBSTITUTE_VALUE)


def opener(counters: Counters, **more: object) -> RecordedOpener:
    return RecordedOpener(counters, 65_000, setpoint_groups=SETPOINTS, max_message_bytes=1 << 20, **more)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]


class Replayed:
    """A recording that is played back to a server that hears it."""

    def __init__(self, recording: Recording, *, with_keys: bool = True, **more: object) -> None:
        self.counters = Counters()
        self.opener = opener(self.counters)
        if with_keys:
            self.opener.keys.update(keys())
        playback = Playback(self.counters, setpoint_groups=SETPOINTS)
        publisher = Publisher(REPLAY_SPACE, PubSubTiming(), Counters(), CODEC)
        self.replay = Replay(publisher, REPLAY_SPACE, **more)  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
        self.sent: list[bytes] = []
        self.reading = Reading()
        self.told: list[SubscriberEvent] = []
        end = 0.0
        for record in recording.records:
            end = (record.time_ns - BEGUN_NS) / 1e9
            self._take(playback.feed(self.opener.open(record, end), end), end)
        self._take(playback.feed(None, end + 10), end + 10)
        self._hear(self.replay.end(end + 10), end + 10)

    def _take(self, facts: list[SubscriberEvent], now: float) -> None:
        for fact in facts:
            self._hear(self.replay.take(fact, now=now, wall_ticks=WALL), now)

    def _hear(self, datagrams: list[bytes], now: float) -> None:
        self.sent += datagrams
        self.told += self.reading.receive(datagrams, now)

    @property
    def values(self) -> list[tuple[Topic, tuple[object, ...], int | None]]:
        heard = only(DataReceived, self.told)
        return [(event.topic, event.message.values, event.message.status) for event in heard]


def line(mode: SecurityMode = SecurityMode.NONE, settings: dict[Topic, WriterSettings] | None = None) -> Recording:
    recording = Recording(mode, settings or {})
    for topic in (ARM, LEG):
        recording.announce(topic)
    for step in range(5):
        recording.now = float(step)
        recording.add(*recording.publisher.poll(recording.now))
        recording.publish(ARM, float(step))
        if step == 3:
            recording.publish(LEG, 7.0, "l" * 5000, status=int(StatusCode.UNCERTAIN))
    return recording


ARM_THERE, LEG_THERE = Topic(REPLAY_SPACE, 2, 1001), Topic(REPLAY_SPACE, 2, 1002)
GONE = int(StatusCode.BAD_NO_COMMUNICATION)


@pytest.mark.parametrize("mode", [SecurityMode.NONE, SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT])
@pytest.mark.parametrize(
    "settings",
    [{}, {ARM: WriterSettings(FieldEncoding.RAW_DATA, 3), LEG: WriterSettings(FieldEncoding.RAW_DATA)}],
    ids=["key frames", "deltas of RawData"],
)
def test_values_come_again_as_substitutes_of_another_origin(
    mode: SecurityMode, settings: dict[Topic, WriterSettings]
) -> None:
    replayed = Replayed(line(mode, settings))
    assert replayed.values[:6] == [
        *[(ARM_THERE, (float(step), "a"), SUBSTITUTE) for step in range(4)],
        (LEG_THERE, (7.0, "l" * 5000), SUBSTITUTE),
        (ARM_THERE, (4.0, "a"), SUBSTITUTE),
    ]
    assert {(topic, status) for topic, _, status in replayed.values[6:]} == {(ARM_THERE, GONE), (LEG_THERE, GONE)}
    stamps = [event.message.timestamp for event in only(DataReceived, replayed.told) if event.topic == ARM_THERE]
    assert stamps[:5] == [WALL + step * 10_000_000 for step in range(5)], "the times that the values had"
    assert replayed.replay.values == 6
    assert not replayed.counters.drops


def test_nothing_replayed_reaches_a_robot_or_announces_one() -> None:
    recording = Recording()
    fields = (make_field("level", BuiltinType.DOUBLE, properties={"Robot": "{}", "RosType": "std_msgs/Float64"}),)
    recording.announce(ARM, fields=fields)
    replayed = Replayed(recording)
    [met] = only(MetaDataReceived, replayed.told)
    assert first_property(met.metadata, NODE_ONLY) is True
    assert first_property(met.metadata, "Robot") is None
    assert first_property(met.metadata, "RosType") is None


def test_a_bad_value_stays_bad() -> None:
    recording = Recording()
    recording.announce(ARM)
    recording.publish(ARM, 1.0, status=int(StatusCode.BAD_SENSOR_FAILURE))
    assert Replayed(recording).values[0][2] == StatusCode.BAD_SENSOR_FAILURE


def test_a_source_that_fell_silent_then_falls_silent_again() -> None:
    recording = Recording()
    recording.announce(ARM)
    recording.publish(ARM, 1.0)
    recording.now = 20.0
    recording.publish(ARM, 2.0)
    assert Replayed(recording).values[:3] == [
        (ARM_THERE, (1.0, "a"), SUBSTITUTE),
        (ARM_THERE, (1.0, "a"), GONE),
        (ARM_THERE, (2.0, "a"), SUBSTITUTE),
    ]


def test_no_command_is_ever_replayed() -> None:
    for mode in (SecurityMode.NONE, SecurityMode.SIGN_AND_ENCRYPT):
        recording = line(mode)
        recording.add(action())
        if mode is SecurityMode.NONE:
            recording.add(setpoint())
        replayed = Replayed(recording)
        assert replayed.opener.left_out == (2 if mode is SecurityMode.NONE else 1)
        messages = decoded(replayed.sent)
        assert not [message for message in messages if isinstance(message, ActionMessage)]
        data = [message for message in messages if isinstance(message, NetworkMessage)]
        assert {message.publisher_id for message in data} == {REPLAY_SPACE}
        assert {message.writer_group_id for message in data} == {2}


def test_without_a_key_nothing_is_replayed_and_it_is_counted() -> None:
    replayed = Replayed(line(SecurityMode.SIGN_AND_ENCRYPT), with_keys=False)
    assert replayed.values == []
    assert set(replayed.counters.drops) == {Drop.SECURED}
    signed = Recording(SecurityMode.SIGN)
    signed.announce(ARM)
    other = opener(Counters(), one_key=keys()["t-1/2"])
    assert [other.open(record, 0.0) for record in signed.records] == [None, None]


def test_only_some_of_it_and_in_another_namespace() -> None:
    def only_leg(topic: Topic) -> bool:
        return topic == LEG

    replayed = Replayed(line(), only=only_leg, namespace=5)
    assert {topic for topic, _, _ in replayed.values} == {Topic(REPLAY_SPACE, 5, 1002)}
    announced = [message for message in decoded(replayed.sent) if isinstance(message, MetaDataAnnouncement)]
    assert {message.data_set_writer_id for message in announced} == {1002}
