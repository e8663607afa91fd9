"""JSON that is mutated, repeated, out of order and flooded: counted by cause, bounded, and the rest goes on."""

from __future__ import annotations

import json
import os
import tracemalloc
from random import Random
from typing import Any

import pytest

from tests.unit.pubsub.publishing import FIELDS, WALL, only
from tests.unit.transport.mqtt.json_connection import METADATA, QUEUE, Process
from tests.unit.wire.json.test_fuzz import mutate
from ua_fleet.counters import Drop
from ua_fleet.pubsub import make_field
from ua_fleet.pubsub.events import DataReceived
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.json import Descriptions, JsonReader
from ua_fleet.transport.mqtt.json.undescribed import LATE_S, Undescribed
from ua_fleet.transport.mqtt.topics import TopicTree
from ua_fleet.values import BuiltinType
from ua_fleet.wire.actions import ActionMessage, ActionState, encode_action
from ua_fleet.wire.discovered import ActionTarget
from ua_fleet.wire.json import JSON_PAYLOAD, JsonCause
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldMetaData,
    FrameKind,
    MetaDataAnnouncement,
    PublisherIdType,
)

MUTATIONS = 200_000 if os.environ.get("UA_FLEET_ALL_MUTATIONS") else 3_000
MIB = 1 << 20
ACTION = Topic(1, 2, 1010)
ARGUMENTS = (make_field("what", BuiltinType.STRING), make_field("strength", BuiltinType.DOUBLE))
HOSTILE_TOPICS = [
    "#",
    "+",
    "$SYS/broker/version",
    "ua_1_2_1001/x",
    "ua_1_2_1001\0",
    "ua_01_2_1001",
    "ua_1_2_99999999999999999999",
    "opcua/json",
    "opcua/json/",
    "opcua/json/status/",
    "opcua/json/status/1/2",
    "opcua/json/metadata/%/%%/%zz",
    "opcua/json/data/1/" + "g" * 64_000,
    "\N{ROBOT FACE}" * 200,
]


def request() -> bytes:
    types = (int(BuiltinType.STRING), int(BuiltinType.DOUBLE))
    return encode_action(
        ActionMessage(
            1,
            ACTION.ns,
            ACTION.id,
            1,
            7,
            ActionState.EXECUTING,
            True,
            requestor_id="0.server",
            correlation_data=bytes(16),
            timeout_hint_ms=1000.0,
            types=types,
            values=("weld", 0.5),
            timestamp=WALL,
        )
    )


def spoken() -> list[tuple[str, bytes]]:
    """What one process says: announcements, values, a keep-alive, an Action."""
    one = Process(1)
    sent = one.begin() + one.publish(1.5) + one.publish(2.5, later=1)
    action = one.publisher.announce_action(
        ACTION, "work", (ActionTarget(1, "arm"),), ARGUMENTS, (), now=one.now, wall_ticks=WALL
    )
    sent += one.send(action) + one.send([request()])
    for _ in range(4):
        one.now += 1.0
        sent += one.send(one.publisher.poll(one.now, WALL))
    return [(each.topic, each.payload) for each in sent]


def test_mutated_messages_cost_themselves_and_nothing_else() -> None:
    chance = Random(15)
    said = spoken()
    texts = [text for _, text in said]
    trees = [json.loads(text) for text in texts]
    other = Process(0)
    tracemalloc.start()
    try:
        for number in range(MUTATIONS):
            topic, _ = chance.choice(said)
            if number % 20 == 0:
                topic = chance.choice(HOSTILE_TOPICS)
            other.hear(topic, mutate(chance, texts, trees), is_retained=chance.random() < 0.2)
            if number % 100 == 0:
                other.wait(0.5)
        used, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert used < 40 * MIB
    assert set(other.core.malformed) <= {cause.value for cause in JsonCause}
    assert sum(other.core.malformed.values()) > MUTATIONS / 20
    drops = other.core.take_drops()
    assert drops[Drop.NOT_ITS_TOPIC] > MUTATIONS / 20
    assert drops[Drop.RETAINED] > 0
    five = Process(5)
    source = Topic(5, 2, 4001)
    announced = five.send(five.publisher.announce(source, "other", FIELDS, now=five.now, wall_ticks=WALL))
    value = five.send(five.publisher.publish(source, (1.0, "x"), timestamp=WALL, now=five.now))
    (data,) = only(DataReceived, other.hear_all(announced + value))
    assert (data.topic, data.message.values) == (source, (1.0, "x"))


def test_doubles_and_what_comes_out_of_order_are_told_by_their_numbers() -> None:
    one, other = Process(1), Process(0)
    other.hear_all(one.begin())
    sent = [one.publish(float(number), later=number)[0] for number in range(8)]
    order = [0, 0, 1, 3, 2, 2, 1, 4, 7, 6, 5, 0]
    events = [event for index in order for event in other.hear(sent[index].topic, sent[index].payload)]
    values = [event.message.values[0] for event in only(DataReceived, events)]
    assert values == [0.0, 1.0, 3.0, 4.0, 7.0]
    drops = other.counters.drops
    assert drops[Drop.DUPLICATE] + drops[Drop.LATE] == len(order) - len(values)


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (b'{"speed": "' + b"x" * (5 * MIB) + b'"}', JsonCause.SIZE),
        (b"[" + b"1," * 300_000 + b"1]", JsonCause.ELEMENTS),
        (b'{"a":' * 40 + b"1" + b"}" * 40, JsonCause.DEPTH),
        (b'{"speed": 1' + b"0" * 400 + b"}", JsonCause.SYNTAX),
        (b'{"speed": "\xc3', JsonCause.SYNTAX),
    ],
    ids=["5 MiB", "300,000 elements", "40 deep", "a huge number", "half a character"],
)
def test_a_message_that_is_too_much_is_refused_by_its_cause(text: bytes, cause: JsonCause) -> None:
    other = Process(0)
    assert other.hear(QUEUE, text) == []
    assert other.core.malformed == {cause.value: 1}


def test_a_flood_of_retained_metadata_leaves_what_has_data() -> None:
    one, other = Process(1), Process(0)
    other.hear_all(one.begin() + one.publish(1.0))
    (metadata,) = [json.loads(each.payload) for each in Process(1).begin() if each.topic == METADATA]
    for number in range(1_500):
        publisher, name = str(10 + number % 200), f"w{number}"
        forged = metadata | {"PublisherId": publisher, "DataSetWriterId": 1 + number // 200}
        forged |= {"DataSetWriterName": name}
        other.hear(f"opcua/json/metadata/{publisher}/group-2/{name}", forged, is_retained=True)
    (data,) = only(DataReceived, other.hear_all(one.publish(2.0, later=1)))
    assert data.message.values == (2.0, "a")


def metadata_of(publisher: int, *, text: str = "") -> MetaDataAnnouncement:
    field = FieldMetaData(f"speed{text}", int(BuiltinType.DOUBLE))
    metadata = DataSetMetaData("arm", (field,), ConfigurationVersion(1, 1))
    return MetaDataAnnouncement(publisher, PublisherIdType.UINT16.value, 0, 1, metadata)


def test_descriptions_are_bounded_in_number_and_memory_and_the_used_ones_stay() -> None:
    known = Descriptions(most=3, most_bytes=5_000)
    assert known.learn(metadata_of(1), "arm")
    assert known.fields("1", 1) is not None
    for publisher in range(2, 10):
        assert known.learn(metadata_of(publisher), "arm")
    assert len(known) == 3
    assert known.fields("1", 1) is not None
    assert known.writer_id("2", "arm") is None, "it has made room"
    assert not known.learn(metadata_of(20, text="x" * 10_000), "arm")
    assert known.bytes <= 5_000
    assert known.fields("1", 1) is not None
    assert known.fields("9", 1) is None


def test_metadata_takes_as_much_of_the_bound_as_its_message_is_long() -> None:
    descriptions = Descriptions(most_bytes=100_000)
    reader = JsonReader(0, Descriptions(), descriptions)
    place = TopicTree(is_json=True).read(METADATA)
    assert place is not None
    (metadata,) = [json.loads(each.payload) for each in Process(1).begin() if each.topic == METADATA]
    metadata["MetaData"]["SimpleDataTypes"] = [{"Name": "x" * 30_000}]
    for number in range(1, 9):
        assert reader.read(place, json.dumps(metadata | {"DataSetWriterId": number}).encode(), 0.0)
    assert len(descriptions) == 3


def held(number: int, size: int = 10) -> DataSetMessage:
    return DataSetMessage(number, FrameKind.KEY.value, raw=b'"' + b"x" * size + b'"', encoding=JSON_PAYLOAD)


def test_what_is_held_is_bounded_and_counted_when_it_goes() -> None:
    waiting = Undescribed(most=3, most_bytes=10_000)
    for number in range(1, 6):
        assert waiting.put(Topic(1, 2, number), "w", held(number), 0.0, may_show=True) == []
    assert waiting.lost == 2
    waiting.put(Topic(1, 2, 9), "w", held(9, 20_000), 0.0, may_show=True)
    assert waiting.bytes <= 10_000
    assert waiting.lost == 6, "the large one cannot be held either"
    assert waiting.poll(LATE_S) == []


def test_what_is_held_waits_so_long_and_keeps_so_much_of_its_name() -> None:
    source, waiting = Topic(1, 2, 1), Undescribed()
    waiting.put(source, "w" * 10_000, held(1), 0.0, may_show=True)
    ((_, announcement, _),) = waiting.poll(LATE_S)
    assert announcement.metadata.name == "w" * 256
    keep_alive = DataSetMessage(1, FrameKind.KEEP_ALIVE.value)
    waiting.put(source, "w", keep_alive, 9.0, may_show=True)
    assert waiting.described(1, 1, 9.0 + 2 * LATE_S) != [], "the keep-alive attests it"
    waiting.put(source, "w", held(1), 20.0, may_show=False)
    assert waiting.described(1, 1, 20.1 + 2 * LATE_S) == []
    assert (waiting.lost, waiting.bytes, bool(waiting)) == (1, 0, False)


def test_of_many_sources_without_metadata_memory_is_bounded() -> None:
    other = Process(0)
    tracemalloc.start()
    try:
        for number in range(3_000):
            message: Any = {"text": "x" * 20_000, "number": number}
            other.hear(f"ua_{1 + number % 200}_2_{1 + number // 200}", message)
        used, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert used < 30 * MIB
    assert other.core.take_drops()[Drop.NO_METADATA] >= 2_000
