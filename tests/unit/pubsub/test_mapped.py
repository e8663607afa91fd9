"""Publishers that are no bridges, as the data of robots; the bytes are those that open62541 1.5.7 sent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.unit.fleet.fleet_of import METADATA, ROBOTS, SPEED, Fleet
from tests.unit.pubsub.publishing import CODEC
from ua_fleet.config.nodes import fleet_model, mapped_sources
from ua_fleet.config.schema import FleetConfig, UnknownSources
from ua_fleet.counters import Counters, Drop
from ua_fleet.fleet import FleetState, Noticed, SourceQuarantined, ValueChanged
from ua_fleet.fleet.changes import SourceReleased
from ua_fleet.pubsub import DataReceived, PubSubTiming, SourceUnknown, Subscriber, SubscriberEvent, make_field
from ua_fleet.pubsub.mapped import MappedSource, MappedSources
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    NetworkMessage,
    Probe,
    ProbeKind,
    PublisherIdType,
)

VECTORS = Path(__file__).parents[2] / "vectors"
PEER = [bytes.fromhex(line) for line in (VECTORS / "peer_none.hex").read_text().split()]
FIELDS = {
    "Temp": {"type": "Double"},
    "Counter": {"type": "Int32"},
    "Flag": {"type": "Boolean"},
    "Stamp": {"type": "DateTime"},
    "Text": {"type": "String"},
}
DOUBLE = int(BuiltinType.DOUBLE)


def config_with(**sources: Any) -> FleetConfig:
    data = {"oven": {"id": 1301, "fields": {"Temp": {"type": "Double"}, "Text": {"type": "String"}}}}
    robots = {**ROBOTS, "press": {"bridge": "mobile", "data": {**data, "level": {"id": 1302, "type": "Double"}}}}
    return FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"mobile": {"kind": "ros2", "space": 2, "status_id": 1900}},
            "robots": robots,
            "sources": sources,
        }
    )


class Server:
    """A subscriber and the state of the fleet behind it."""

    def __init__(self, config: FleetConfig, policy: UnknownSources = UnknownSources.QUARANTINE) -> None:
        self.counters = Counters()
        self.subscriber = Subscriber(0, PubSubTiming(), self.counters, CODEC, mapped=mapped_sources(config))
        self.state = FleetState(fleet_model(config), self.counters, unknown_sources=policy)
        self.changes: list[Any] = []
        self.events: list[SubscriberEvent] = []

    def hear(self, *datagrams: bytes, now: float = 0.0) -> None:
        for datagram in datagrams:
            self.take(self.subscriber.receive(datagram, now))
        self.take(self.subscriber.poll(now))

    def take(self, events: list[SubscriberEvent]) -> None:
        self.events += events
        for event in events:
            self.changes += self.state.apply(event, 1)

    def shown(self) -> dict[Any, Any]:
        return {
            change.key.identifier: (change.value, change.status)
            for change in self.changes
            if isinstance(change, ValueChanged)
        }


def test_a_publisher_that_announces_nothing_has_a_node_by_the_fields_that_are_stated() -> None:
    oven = {"publisher_id": 2234, "writer_group_id": 100, "data_set_writer_id": 62541, "robot": "press", "data": "oven"}
    server = Server(config_with(oven={**oven, "fields": FIELDS}))
    server.hear(*PEER)
    assert server.shown()["1301.Temp"] == (21.5, 0)
    assert server.shown()["1301.Text"] == ("robot-7", 0)
    assert server.counters.drops == {}
    assert not [event for event in server.events if isinstance(event, SourceUnknown)], "nobody is asked"


IDS: list[tuple[str, Any, PublisherIdType]] = [
    ("Byte", 7, PublisherIdType.BYTE),
    ("UInt16", 240, PublisherIdType.UINT16),
    ("UInt32", 70_000, PublisherIdType.UINT32),
    ("UInt64", 1 << 60, PublisherIdType.UINT64),
    ("String", "Oven 7", PublisherIdType.STRING),
]


@pytest.mark.parametrize("group_id", [None, 0, 100, 65_535])
@pytest.mark.parametrize(("kind", "publisher_id", "code"), IDS)
def test_any_publisher_id_and_writer_group_can_be_a_node(
    kind: str, publisher_id: Any, code: PublisherIdType, group_id: int | None
) -> None:
    source = {"publisher_id": publisher_id, "publisher_id_type": kind, "data_set_writer_id": 9}
    given = {**source, "robot": "press", "data": "level", "fields": {"x": {"type": "Double"}}}
    if group_id is not None:
        given["writer_group_id"] = group_id
    server = Server(config_with(level=given))
    part = DataSetMessage(9, types=(DOUBLE,), values=(2.5,), sequence_number=1)

    def sent(type_code: int, group: int | None) -> bytes:
        message = NetworkMessage(publisher_id, writer_group_id=group, messages=(part,))
        return CODEC.encode(message._replace(publisher_id_type=type_code))

    server.hear(sent(int(code), 5))
    assert server.shown() == {}, "another WriterGroup is another writer"
    server.hear(sent(int(code), group_id))
    assert server.shown()[1302] == (2.5, 0)


def test_what_nobody_maps_is_said_once_and_not_in_silence() -> None:
    server = Server(config_with())
    part = DataSetMessage(9, types=(DOUBLE,), values=(2.5,))
    for _ in range(5):
        server.hear(
            CODEC.encode(NetworkMessage("ov\x1ben", PublisherIdType.STRING, writer_group_id=100, messages=(part,)))
        )
    assert server.counters.drops == {Drop.UNKNOWN_SOURCE: 5}
    [said] = server.subscriber.complaints(1.0)
    assert said.count == 5
    assert "PublisherId 'ov\\x1ben' (String), WriterGroupId 100, DataSetWriterId 9" in said.detail
    assert "`sources` of fleet.yaml" in said.detail
    assert server.subscriber.complaints(2.0) == []


def test_a_publisher_that_announces_what_it_sends_needs_no_fields() -> None:
    source = MappedSource((int(PublisherIdType.STRING), "oven"), 100, 9, SPEED)
    subscriber = Subscriber(0, PubSubTiming(), Counters(), CODEC, mapped=MappedSources([source]))
    part = DataSetMessage(9, types=(DOUBLE,), values=(1.5,), sequence_number=1)
    message = NetworkMessage("oven", PublisherIdType.STRING, writer_group_id=100, messages=(part,))
    assert subscriber.receive(CODEC.encode(message), 0.0) == []
    [unknown] = subscriber.poll(0.6)
    assert isinstance(unknown, SourceUnknown)
    assert unknown.datagram is not None
    probe = CODEC.decode(unknown.datagram)
    assert probe == Probe("oven", PublisherIdType.STRING, ProbeKind.DATA_SET_META_DATA, (9,))
    fleet = Fleet()
    assert fleet.state.apply(unknown, 1) == []


def test_the_address_of_a_mapped_source_is_nobody_elses() -> None:
    source = {"publisher_id": 2234, "data_set_writer_id": 9, "robot": "press", "data": "level"}
    server = Server(config_with(level={**source, "fields": {"x": {"type": "Double"}}}))
    part = DataSetMessage(1302, types=(DOUBLE,), values=(66.0,))
    server.hear(CODEC.encode(NetworkMessage(2, writer_group_id=2, messages=(part,))))
    assert server.counters.drops == {Drop.CONFLICT: 1}
    assert server.shown() == {}


def unannounced(server: Server, topic: Topic) -> None:
    part = DataSetMessage(topic.id, types=(DOUBLE,), values=(2.5,))
    for step in range(60):
        datagram = CODEC.encode(NetworkMessage(topic.space, writer_group_id=topic.ns, messages=(part,)))
        server.hear(datagram, now=step / 10)


@pytest.mark.parametrize("policy", [UnknownSources.QUARANTINE, UnknownSources.CREATE])
def test_a_source_that_never_says_what_it_sends_is_listed_with_the_reason(policy: UnknownSources) -> None:
    server = Server(config_with(), policy)
    topic = Topic(300, 2, 9)
    unannounced(server, topic)
    [listed] = [change for change in server.changes if isinstance(change, SourceQuarantined)]
    assert (listed.topic, "announces no metadata; state its fields in `sources`" in listed.reason) == (topic, True)
    assert len([change for change in server.changes if isinstance(change, Noticed)]) == 1
    assert not [event for event in server.events if isinstance(event, DataReceived)]
    released = server.state._discovery.meet(topic, METADATA[SPEED], 1)[1]  # pyright: ignore[reportPrivateUsage]
    assert isinstance(released[0], SourceReleased), "it has announced after all"


def test_the_data_of_a_robot_that_never_says_what_it_sends_is_told_once() -> None:
    server = Server(config_with())
    unannounced(server, SPEED)
    [said] = [change for change in server.changes if isinstance(change, Noticed)]
    assert "announces no metadata" in said.text


def test_ignored_sources_are_not_listed() -> None:
    server = Server(config_with(), UnknownSources.IGNORE)
    unannounced(server, Topic(300, 2, 9))
    assert server.changes == []


def test_a_source_comes_only_by_the_connections_of_its_robot() -> None:
    metadata = DataSetMetaData("oven", (make_field("x", BuiltinType.DOUBLE),), ConfigurationVersion(0, 0))
    source = MappedSource((int(PublisherIdType.STRING), "oven"), 100, 9, SPEED, metadata)
    counters = Counters()
    subscriber = Subscriber(0, PubSubTiming(), counters, CODEC, mapped=MappedSources([source]))
    subscriber.add_connection(None, barred=(SPEED.space,))
    part = DataSetMessage(9, types=(DOUBLE,), values=(1.5,), sequence_number=1)
    sent = CODEC.encode(NetworkMessage("oven", PublisherIdType.STRING, writer_group_id=100, messages=(part,)))
    assert subscriber.receive(sent, 0.0, connection=1) == []
    assert counters.drops == {Drop.NOT_ITS_CONNECTION: 1}
    assert [event for event in subscriber.receive(sent, 0.0, connection=0) if isinstance(event, DataReceived)]
