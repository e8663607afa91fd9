"""Bridges with another PublisherId on the wire than the number of their space: all types, with and without keys."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from tests.unit.pubsub.publishing import CODEC, FIELDS, TOPIC, WALL, decoded, only
from tests.unit.pubsub.security.securing import envelope
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub import DataReceived, MetaDataReceived, Publisher, PubSubTiming, Subscriber, SubscriberEvent
from ua_fleet.pubsub.application import PRODUCT_URI, Application, describe
from ua_fleet.pubsub.events import ActionReceived, ProbeReceived, SourceUnknown
from ua_fleet.pubsub.publisher_ids import PublisherId, PublisherIds
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, Variant
from ua_fleet.wire import SecurityMode, encode_action, encode_probe, read_security
from ua_fleet.wire.actions import ActionMessage, ActionState
from ua_fleet.wire.discovered import ConnectionsAnnouncement
from ua_fleet.wire.messages import Probe, ProbeKind, PublisherIdType

T = PublisherIdType
IDS: list[PublisherId] = [
    (T.BYTE.value, 7),
    (T.UINT16.value, 40_000),
    (T.UINT32.value, 123_456),
    (T.UINT64.value, 1 << 60),
    (T.STRING.value, "press-7 ü"),
]
MODES = [SecurityMode.NONE, SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT]
BUILTIN = {
    0: BuiltinType.BYTE,
    1: BuiltinType.UINT16,
    2: BuiltinType.UINT32,
    3: BuiltinType.UINT64,
    4: BuiltinType.STRING,
}


class Fleet:
    """The bridge of space 1, which has a PublisherId of its own, and the server."""

    def __init__(self, wire_id: PublisherId, mode: SecurityMode, random: int | None = None) -> None:
        ids = PublisherIds({1: wire_id})
        groups = () if mode is SecurityMode.NONE else ("t-0", "t-1", "c-1")
        self.bridge = envelope(1, *groups, mode=mode, max_datagram_bytes=1400, publisher_ids=ids, random=random)
        self.server = envelope(0, *groups, mode=mode, publisher_ids=ids)
        application = Application(
            describe(PRODUCT_URI, "bridge"), max_message_bytes=1 << 20, publisher_id=ids.variant(1)
        )
        self.publisher = Publisher(
            1, PubSubTiming(), Counters(), CODEC, application, max_packed_bytes=self.bridge.max_plain_bytes
        )
        self.counters, self.own_counters = Counters(), Counters()
        self.reading = Subscriber(0, PubSubTiming(), self.counters, CODEC, envelope=self.server, publisher_ids=ids)
        self.own = Subscriber(1, PubSubTiming(), self.own_counters, CODEC, envelope=self.bridge, publisher_ids=ids)
        self.on_wire: list[bytes] = []

    def hear(self, plain: Iterable[bytes], now: float = 0.0) -> list[SubscriberEvent]:
        sealed = [datagram for message in plain for datagram in self.bridge.seal(message, now)]
        self.on_wire += sealed
        return [event for datagram in sealed for event in self.reading.receive(datagram, now)]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("wire_id", IDS)
def test_everything_of_a_bridge_has_its_publisher_id_and_is_known_by_its_space(
    wire_id: PublisherId, mode: SecurityMode
) -> None:
    fleet = Fleet(wire_id, mode)
    events = fleet.hear(fleet.publisher.announce(TOPIC, "arm", FIELDS, now=0.0, wall_ticks=WALL))
    large = "m" * 20_000
    for values in ((1.0, "a"), (2.0, large)):
        events += fleet.hear(fleet.publisher.publish(TOPIC, values, timestamp=WALL, now=0.0))
    assert [event.topic for event in only(MetaDataReceived, events)] == [TOPIC]
    assert [event.message.values for event in only(DataReceived, events)] == [(1.0, "a"), (2.0, large)]
    assert not fleet.counters.drops
    assert len(fleet.on_wire) > 15, "the large one goes as chunks"
    assert max(map(len, fleet.on_wire)) <= 1400
    for datagram in fleet.on_wire:
        heard = read_security(datagram)
        assert (heard.publisher_id_type, heard.publisher_id) == wire_id


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("wire_id", IDS)
def test_a_bridge_drops_what_comes_back_to_it_and_tells_a_second_process(
    wire_id: PublisherId, mode: SecurityMode
) -> None:
    fleet = Fleet(wire_id, mode)
    fleet.hear(fleet.publisher.announce(TOPIC, "arm", FIELDS, now=0.0, wall_ticks=WALL))
    fleet.on_wire.clear()
    fleet.hear(fleet.publisher.publish(TOPIC, (1.0, "a"), timestamp=WALL, now=0.0))
    [datagram] = fleet.on_wire
    assert fleet.own.receive(datagram, 0.0) == []
    assert fleet.own_counters.drops == {Drop.LOOP: 1}
    rivals: list[object] = []

    def impostor(sender: tuple[str, int], _now: float) -> bool:
        rivals.append(sender)
        return True

    fleet.own.impostor = impostor
    other = Fleet(wire_id, mode, random=99)
    [foreign] = other.bridge.seal(other.publisher.announce(TOPIC, "arm", FIELDS, now=0.0, wall_ticks=WALL)[1], 0.0)
    fleet.own.receive(foreign, 0.0, ("127.0.0.9", 1))
    assert rivals == [("127.0.0.9", 1)]
    assert fleet.own_counters.drops[Drop.CONFLICT] == 1


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("wire_id", IDS)
def test_a_probe_and_an_action_find_it_and_it_announces_its_name(wire_id: PublisherId, mode: SecurityMode) -> None:
    fleet = Fleet(wire_id, mode)
    probe = encode_probe(Probe(1, T.UINT16, ProbeKind.PUBSUB_CONNECTIONS))
    [sealed] = fleet.server.seal(probe, 0.0)
    assert read_security(sealed).publisher_id == wire_id[1]
    [asked] = only(ProbeReceived, fleet.own.receive(sealed, 0.0))
    answer = fleet.publisher.answer(asked.probe, 0.0)
    [announced] = [one for one in decoded(answer) if isinstance(one, ConnectionsAnnouncement)]
    assert announced.connections[0].publisher_id == Variant(int(BUILTIN[wire_id[0]]), wire_id[1])
    action = ActionMessage(
        1, 2, 7, 1, 1, ActionState.EXECUTING, is_request=True, requestor_id="0.a", correlation_data=b"x"
    )
    for datagram in fleet.server.seal(encode_action(action), 0.0):
        assert read_security(datagram).publisher_id == wire_id[1]
        [received] = only(ActionReceived, fleet.own.receive(datagram, 0.0))
        assert (received.message.publisher_id, received.message.requestor_id) == (1, "0.a")


def test_a_reader_asks_by_the_name_on_the_wire() -> None:
    fleet = Fleet(IDS[4], SecurityMode.NONE)
    fleet.publisher.announce(TOPIC, "arm", FIELDS, now=0.0, wall_ticks=WALL)
    fleet.hear(fleet.publisher.publish(TOPIC, (1.0, "a"), timestamp=WALL, now=0.0))
    [unknown] = only(SourceUnknown, fleet.reading.poll(0.6))
    assert unknown.datagram is not None
    [sealed] = fleet.server.seal(unknown.datagram, 0.6)
    assert b"press-7" in sealed
    [asked] = only(ProbeReceived, fleet.own.receive(sealed, 0.6))
    events = fleet.hear(fleet.publisher.answer(asked.probe, 0.6), 0.6)
    assert [event.message.values for event in only(DataReceived, events)] == [(1.0, "a")]


def test_other_publishers_are_who_they_were() -> None:
    fleet = Fleet(IDS[4], SecurityMode.NONE)
    other = Publisher(2, PubSubTiming(), Counters(), CODEC)
    topic = Topic(2, 2, 5)
    events = fleet.hear(other.announce(topic, "leg", FIELDS, now=0.0, wall_ticks=WALL))
    events += fleet.hear(other.publish(topic, (1.0, "a"), timestamp=WALL, now=0.0))
    assert [event.topic for event in only(DataReceived, events)] == [topic]
    ids = PublisherIds({1: IDS[4]})
    for broken in (b"", b"\x00", b"\xf1", b"\xf1\x04", b"\xf1\x04\xff", b"\xf1\x07\x01\x02", b"\x01"):
        assert ids.inward(broken) == ids.outward(broken) == broken
