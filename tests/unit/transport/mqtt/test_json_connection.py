"""JSON over a broker: the publisher and the subscriber of every connection, with text between them."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.unit.pubsub.publishing import FIELDS, TOPIC, WALL, only
from tests.unit.transport.mqtt.json_connection import METADATA, QUEUE, Process
from ua_fleet.counters import Drop
from ua_fleet.pubsub.events import AnnouncementReceived, DataReceived, MetaDataReceived, SourceSilent
from ua_fleet.transport.mqtt.core import Outgoing
from ua_fleet.transport.mqtt.json.undescribed import LATE_S
from ua_fleet.values import BuiltinType
from ua_fleet.wire import Codec, encode_probe
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement
from ua_fleet.wire.json import Form
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FrameKind,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)


def texts(sent: list[Outgoing]) -> dict[str, Any]:
    return {each.topic: json.loads(each.payload) for each in sent}


def values(events: list[Any]) -> list[tuple[Any, ...]]:
    return [event.message.values for event in only(DataReceived, events)]


def test_a_publisher_has_its_announcements_retained_as_json_before_its_data() -> None:
    process = Process(1)
    sent = process.begin() + process.publish(1.5)
    retained = {each.topic: json.loads(each.payload)["MessageType"] for each in sent if each.is_retained}
    assert retained == {
        "opcua/json/application/1": "ua-application",
        "opcua/json/status/1": "ua-status",
        "opcua/json/connection/1": "ua-connection",
        "opcua/json/action-responder/1": "ua-action-responder",
        METADATA: "ua-metadata",
    }
    topics = [each.topic for each in sent]
    assert topics.index(METADATA) < topics.index(QUEUE)


def test_a_value_is_plain_json_on_the_topic_of_its_source() -> None:
    process = Process(1)
    process.begin()
    (sent,) = process.publish(1.5)
    message = json.loads(sent.payload)
    (part,) = message.pop("Messages")
    assert message.pop("MessageId")
    assert message == {"MessageType": "ua-data", "PublisherId": "1", "WriterGroupName": "group-2"}
    assert (sent.topic, sent.is_retained, sent.qos) == (QUEUE, False, 1)
    assert (part["DataSetWriterId"], part["DataSetWriterName"]) == (TOPIC.id, "arm")
    assert part["Payload"] == {"level": 1.5, "name": "a"}


def test_no_two_messages_have_one_message_id() -> None:
    process = Process(1)
    sent = process.begin() + process.publish(1.0) + process.publish(2.0, later=1) + Process(1).begin()
    ids = [json.loads(each.payload)["MessageId"] for each in sent]
    assert len(set(ids)) == len(ids)


@pytest.mark.parametrize("form", Form)
def test_the_other_process_has_the_values_and_the_fields(form: Form) -> None:
    one, other = Process(1, form=form), Process(0)
    events = other.hear_all(one.begin())
    events += other.hear_all(one.publish(1.5))
    assert [event.metadata.name for event in only(MetaDataReceived, events)] == ["arm"]
    assert values(events) == [(1.5, "a")]
    (data,) = only(DataReceived, events)
    assert (data.topic, data.message.timestamp) == (TOPIC, WALL)
    assert data.metadata.fields == FIELDS
    assert not other.counters.drops


def test_a_repeat_is_no_news_and_a_lost_source_is_bad() -> None:
    one, other = Process(1), Process(0)
    other.hear_all(one.begin() + one.publish(1.5))
    one.now += 6.0
    assert not other.hear_all(one.send(one.publisher.poll(one.now, WALL)))
    assert other.counters.drops[Drop.REPEATED] == 1
    events = other.hear_all(one.send(one.publisher.source_lost(TOPIC, timestamp=WALL + 9, now=one.now)))
    (lost,) = only(DataReceived, events)
    assert (lost.message.status or 0) >> 16 == 0x8031


def test_the_will_is_the_status_error_that_is_not_cyclic() -> None:
    process = Process(1)
    will = json.loads(process.core.will(0.0) or b"")
    del will["MessageId"]
    assert will == {
        "MessageType": "ua-status",
        "PublisherId": "1",
        "IsCyclic": False,
        "Status": int(PubSubState.ERROR),
    }


def test_a_will_makes_the_sources_of_its_publisher_silent() -> None:
    one, other = Process(1), Process(0)
    other.hear_all(one.begin() + one.publish(1.5))
    events = other.hear("opcua/json/status/1", one.core.will(0.0) or b"")
    assert [event.topic for event in only(SourceSilent, events)] == [TOPIC]
    (said,) = only(AnnouncementReceived, events)
    assert isinstance(said.announcement, StatusAnnouncement)


def test_probes_have_no_message_and_no_topic() -> None:
    process = Process(1)
    probe = Probe(2, PublisherIdType.UINT16.value, ProbeKind.DATA_SET_META_DATA.value, (1001,))
    assert process.send([encode_probe(probe)]) == []
    assert not process.core.take_drops()
    assert not [each for each in process.core.filters if "probe" in each or "answer" in each]


# Foreign publishers.

PLAIN: list[tuple[Any, dict[str, int]]] = [
    ({"level": 1.5, "name": "a"}, {}),
    ({"Payload": {"name": "a", "level": 1.5}}, {}),
    ([{"DataSetWriterId": 1001, "Payload": {"level": 1.5, "name": "a"}}], {}),
    ({"MessageId": "m", "MessageType": "ua-data", "Messages": [{"Payload": {"level": 1.5, "name": "a"}}]}, {}),
    (
        {
            "MessageId": None,
            "MessageType": "ua-data",
            "PublisherId": 1,
            "Messages": [{"DataSetWriterId": "1001", "Payload": {"level": "1.5", "name": "a"}}],
        },
        {"message_id_missing": 1, "publisher_id_number": 1, "writer_id_text": 1, "number_as_text": 1},
    ),
]


@pytest.mark.parametrize(("message", "forgiven"), PLAIN)
def test_a_foreign_message_on_the_topic_of_a_source_is_that_source(message: Any, forgiven: dict[str, int]) -> None:
    one, other = Process(1), Process(0)
    other.hear_all([each for each in one.begin() if each.is_retained])
    assert values(other.hear(QUEUE, message)) == [(1.5, "a")]
    assert other.core.take_forgiven() == forgiven


def test_what_has_no_metadata_waits_and_is_decoded_when_it_comes() -> None:
    one, other = Process(1), Process(0)
    announced = one.begin()
    assert other.hear(QUEUE, {"level": 1.0, "name": "old"}) == []
    assert other.hear(QUEUE, {"level": 2.0, "name": "new"}) == []
    assert values(other.hear_all(announced)) == [(2.0, "new")]
    assert other.core.take_drops() == {Drop.NO_METADATA: 1}, "the older one was lost"


def test_what_has_waited_is_a_value_of_now_where_the_broker_had_kept_the_metadata_and_else_too_old() -> None:
    announced = [each for each in Process(1).begin() if each.is_retained]
    for seconds, heard, drops in ((1.0, [(2.0, "new")], {}), (2.5 * LATE_S, [], {Drop.NO_METADATA: 1})):
        other = Process(0, described={TOPIC})
        assert other.hear(QUEUE, {"level": 2.0, "name": "new"}) == []
        other.wait(seconds)
        events = [event for each in announced for event in other.hear(each.topic, each.payload, is_retained=True)]
        assert values(events) == heard
        assert other.core.take_drops() == drops
        assert not other.counters.drops


def test_what_gets_no_metadata_is_shown_as_it_came_and_typed_when_metadata_comes() -> None:
    one, other = Process(1), Process(0)
    announced = one.begin()
    message = {"Timestamp": "2026-01-01T00:00:00Z", "Payload": {"level": 2.0, "name": "x"}}
    assert other.hear(QUEUE, message) == []
    assert other.wait(LATE_S / 2) == []
    late = other.wait(LATE_S / 2)
    (described,) = only(MetaDataReceived, late)
    assert [(field.name, field.builtin_type) for field in described.metadata.fields] == [("json", BuiltinType.STRING)]
    assert values(late) == [('{"level":2.0,"name":"x"}',)]
    assert values(other.hear(QUEUE, {"Payload": {"level": 3.0}})) == [('{"level":3.0}',)], "at once, from then on"
    assert values(other.hear(QUEUE, message | {"Timestamp": "2026-01-01T00:00:01Z"})) == [('{"level":2.0,"name":"x"}',)]
    typed = other.hear_all(announced)
    assert values(typed) == [(2.0, "x")], "the same value, with its fields"
    assert only(MetaDataReceived, typed)[-1].metadata.fields == FIELDS
    assert not other.core.take_drops()
    assert not other.counters.drops


def test_a_source_whose_fields_are_known_otherwise_is_never_shown_as_a_text() -> None:
    other = Process(0, described={TOPIC})
    other.hear(QUEUE, {"name": "a"})
    assert other.wait(2 * LATE_S) == []
    assert other.hear(QUEUE, {"name": "a"}) == []
    assert other.core.take_drops() == {Drop.NO_METADATA: 1}
    assert values(other.hear_all([each for each in Process(1).begin() if each.is_retained])) == [(None, "a")]


def test_a_value_of_another_version_waits_for_its_metadata_and_is_not_shown_as_a_text() -> None:
    one, other = Process(1), Process(0)
    other.hear_all(one.begin())
    fields = FIELDS[:1]
    new = one.send(one.publisher.announce(TOPIC, "arm", fields, now=one.now, wall_ticks=WALL + 50_000_000))
    (value,) = one.send(one.publisher.publish(TOPIC, (7.0,), timestamp=WALL + 9, now=one.now))
    assert other.hear(value.topic, value.payload) == []
    assert other.wait(2 * LATE_S) == []
    assert values(other.hear_all(new)) == [(7.0,)]


def test_a_keep_alive_of_what_is_shown_as_text_attests_it_unless_a_value_is_missing() -> None:
    other = Process(0)
    other.hear(QUEUE, {"SequenceNumber": 7, "Payload": {"level": 2.0}})
    other.wait(LATE_S)
    writer = other.subscriber.writers[TOPIC]
    other.now += 1.0
    other.hear(QUEUE, {"MessageType": "ua-keepalive", "SequenceNumber": 8, "DataSetWriterId": 1001})
    assert writer.attested_at == other.now
    other.now += 1.0
    other.hear(QUEUE, {"MessageType": "ua-keepalive", "SequenceNumber": 9, "DataSetWriterId": 1001})
    assert writer.attested_at < other.now


@pytest.mark.parametrize("kind", ["ua-deltaframe", "ua-event"])
def test_a_delta_frame_or_an_event_without_metadata_is_no_value(kind: str) -> None:
    other = Process(0)
    assert other.hear(QUEUE, {"DataSetWriterId": 1001, "MessageType": kind, "Payload": {"level": 2.0}}) == []
    assert other.wait(LATE_S) == []
    assert other.core.take_drops() == {Drop.NO_METADATA: 1}


def test_the_fields_that_fleet_yaml_states_are_those_of_a_writer_that_announces_none() -> None:
    stated = {("1", 1001): DataSetMetaData("arm", FIELDS, ConfigurationVersion(0, 0))}
    other = Process(0, stated=stated)
    version = {"MajorVersion": 7, "MinorVersion": 7}
    for message in ({"level": 1.5, "name": "a"}, {"MetaDataVersion": version, "Payload": {"level": 1.5, "name": "a"}}):
        (heard,) = other.core.received(QUEUE, json.dumps(message).encode(), other.now, is_retained=False)
        decoded = Codec().decode(heard.datagram)
        assert isinstance(decoded, NetworkMessage)
        assert decoded.messages[0].values == (1.5, "a")


def test_what_is_announced_does_not_outrank_the_fields_of_fleet_yaml() -> None:
    one, stated = Process(1), {("1", 1001): DataSetMetaData("arm", FIELDS, ConfigurationVersion(0, 0))}
    other = Process(0, stated=stated)
    (metadata,) = [json.loads(each.payload) for each in one.begin() if each.topic == METADATA]
    metadata["MetaData"]["Fields"][0]["Name"] = "forged"
    other.hear(METADATA, metadata, is_retained=True)
    text = json.dumps({"level": 1.5, "name": "a", "forged": 7.0}).encode()
    (heard,) = other.core.received(QUEUE, text, other.now, is_retained=False)
    decoded = Codec().decode(heard.datagram)
    assert isinstance(decoded, NetworkMessage)
    assert decoded.messages[0].values == (1.5, "a")


def test_a_publisher_of_another_fleet_on_a_standard_topic() -> None:
    other = Process(0)
    message = {
        "MessageId": "m",
        "MessageType": "ua-data",
        "PublisherId": "press 7",
        "WriterGroupName": "main",
        "Messages": [{"DataSetWriterId": 3, "Payload": {"level": 1.5}}],
    }
    assert other.hear("opcua/json/data/press%207/main", message) == []
    assert other.core.take_drops() == {Drop.NO_METADATA: 1}
    other.hear("opcua/json/data/press%207/other", message)
    assert other.core.take_drops() == {Drop.NOT_ITS_TOPIC: 1}


def test_a_writer_that_a_topic_names_need_not_name_itself() -> None:
    """As open62541 with a topic for each DataSetWriter."""
    one, other = Process(1), Process(0)
    other.hear_all(one.begin())
    message = {
        "MessageId": "m",
        "MessageType": "ua-data",
        "PublisherId": "1",
        "WriterGroupName": "group-2",
        "Messages": [{"DataSetWriterId": 1001, "Payload": {"level": 1.5, "name": "a"}}],
    }
    assert values(other.hear("opcua/json/data/1/group-2/arm", message)) == [(1.5, "a")]
    message["Messages"] = [{"DataSetWriterId": 1002, "Payload": {"level": 1.5, "name": "a"}}]
    assert other.hear("opcua/json/data/1/group-2/arm", message) == []
    assert other.core.take_drops() == {Drop.NOT_ITS_TOPIC: 1}


# What is refused.

NOT_ITS: list[tuple[str, Any]] = [
    (QUEUE, {"PublisherId": "2", "DataSetWriterId": 1001, "Payload": {"level": 1.0}}),
    (QUEUE, {"PublisherId": "1", "DataSetWriterId": 1002, "Payload": {"level": 1.0}}),
    (QUEUE, {"WriterGroupName": "group-3", "DataSetWriterId": 1001, "Payload": {"level": 1.0}}),
    (QUEUE, [{"DataSetWriterId": 1001, "Payload": {}}, {"DataSetWriterId": 1002, "Payload": {}}]),
    (QUEUE, {"MessageId": "m", "MessageType": "ua-status", "PublisherId": "1", "IsCyclic": False, "Status": 3}),
    ("opcua/json/status/2", {"MessageId": "m", "MessageType": "ua-status", "PublisherId": "1", "Status": 3}),
    ("opcua/json/application/1", {"MessageId": "m", "MessageType": "ua-status", "PublisherId": "1", "Status": 3}),
    ("opcua/json/metadata/1/group-2/arm", {"level": 1.0}),
    ("opcua/json/probe/1", {"level": 1.0}),
    ("opcua/uadp/metadata/1/group-2/arm", {"level": 1.0}),
    ("$SYS/broker/uptime", b"12 seconds"),
    ("ua_1_2_70000", {"level": 1.0}),
    ("ua_1_2_1001\0", {"level": 1.0}),
    ("x" * 65_535, {"level": 1.0}),
    ("opcua/json/data/#", {"level": 1.0}),
]


@pytest.mark.parametrize(("topic", "message"), NOT_ITS)
def test_a_message_that_claims_what_its_topic_is_not_is_dropped_and_counted(topic: str, message: Any) -> None:
    other = Process(0)
    assert other.hear(topic, message) == []
    assert other.wait(LATE_S) == []
    assert other.core.take_drops() == {Drop.NOT_ITS_TOPIC: 1}


def test_metadata_under_the_name_of_another_writer_is_dropped() -> None:
    one, other = Process(1), Process(0)
    (metadata,) = [each for each in one.begin() if each.topic == METADATA]
    assert other.hear("opcua/json/metadata/1/group-2/other", metadata.payload) == []
    assert other.core.take_drops() == {Drop.NOT_ITS_TOPIC: 1}


def test_retained_data_is_dropped_before_it_is_read() -> None:
    one, other = Process(1), Process(0)
    other.hear_all(one.begin())
    for payload in (one.publish(1.5)[0].payload, b"no json"):
        assert other.hear(QUEUE, payload, is_retained=True) == []
    assert other.core.take_drops() == {Drop.RETAINED: 2}
    assert not other.core.malformed


def test_metadata_of_an_earlier_version_that_was_retained_changes_nothing() -> None:
    one, other = Process(1), Process(0)
    old = [each for each in one.begin() if each.topic == METADATA]
    fields = FIELDS[:1]
    one.now += 1.0
    new = one.send(one.publisher.announce(TOPIC, "arm", fields, now=one.now, wall_ticks=WALL + 50_000_000))
    other.hear_all(new)
    assert other.hear(METADATA, old[0].payload, is_retained=True) == []
    assert other.core.take_drops() == {Drop.RETAINED: 1}
    assert values(other.hear(QUEUE, {"level": 4.0})) == [(4.0,)]


def test_what_others_announce_in_our_name_changes_nothing_of_what_we_say() -> None:
    one, forger = Process(1), Process(1)
    one.begin()
    forger.begin()
    forged = forger.send(forger.publisher.announce(TOPIC, "arm", FIELDS[:1], now=200.0, wall_ticks=WALL * 2))
    assert one.hear_all(forged) == []
    assert json.loads(one.publish(2.0)[0].payload)["Messages"][0]["Payload"] == {"level": 2.0, "name": "a"}


def test_what_is_no_json_is_counted_by_its_cause() -> None:
    other = Process(0)
    for payload in (b"{", b"\xff", b'{"MessageType": "ua-what", "MessageId": "m"}', b"[[[[" + b"[" * 40 + b"]" * 44):
        assert other.hear(QUEUE, payload) == []
    assert sum(other.core.malformed.values()) == 4
    assert other.core.malformed["json_syntax"] == 2
    assert not other.core.take_drops()


def test_setpoints_go_neither_out_nor_in() -> None:
    one, server = Process(1), Process(0)
    part = DataSetMessage(5, FrameKind.KEY.value, (11,), (1.0,), 1, WALL)
    setpoint = Codec().encode(NetworkMessage(0, writer_group_id=77, messages=(part,)))
    assert server.send([setpoint]) == []
    assert server.core.take_drops() == {Drop.NOT_OVER_JSON: 1}
    message = {"PublisherId": "0", "WriterGroupName": "group-77", "DataSetWriterId": 5, "Payload": {"level": 1.0}}
    for topic in ("ua_0_77_5", "opcua/json/data/0/group-77", "opcua/json/data/0/group-77/x"):
        assert one.hear(topic, message) == []
        assert one.core.take_drops() == {Drop.NOT_OVER_JSON: 1}
