"""What refused messages do to sources, from the datagram to the node's status."""

from __future__ import annotations

import tracemalloc
from random import Random

import pytest

from tests.unit.fleet.fleet_of import METADATA, SPEED, Fleet, fleet_config, notices, values
from tests.unit.pubsub.publishing import CODEC, WALL, only
from tests.unit.pubsub.security.securing import (
    ENCRYPT,
    NONE,
    SIGN,
    action,
    announcement,
    data,
    envelope,
    group_keys,
    one,
)
from ua_fleet.config.nodes import fleet_model
from ua_fleet.config.schema import UnknownSources
from ua_fleet.counters import Counters, Drop
from ua_fleet.fleet import Change, FleetState, Noticed, SourceAdded, SourceQuarantined
from ua_fleet.pubsub import (
    DataReceived,
    MetaDataReceived,
    Publisher,
    PubSubTiming,
    SourceAppeared,
    SourceRefused,
    SourceReturned,
    SourceSilent,
    Subscriber,
    SubscriberEvent,
)
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire import SecurityMode

REFUSED, NO_COMMUNICATION = int(StatusCode.BAD_SECURITY_CHECKS_FAILED), int(StatusCode.BAD_NO_COMMUNICATION)
FIELDS = METADATA[SPEED].fields


class Robot:
    """The bridge of space 2 with one source; `keys` are those of the fleet unless they are others."""

    def __init__(self, mode: SecurityMode = ENCRYPT, keys: str = "") -> None:
        self.envelope = Envelope(2, Counters(), mode=mode, nonces=_Once(), random=Random(1))
        self.envelope.install("t-2", group_keys(seed=f"{keys}t-2", next_s=1e6, lifetime_s=1e6), 0.0)
        self.publisher = Publisher(2, PubSubTiming(), Counters(), CODEC)
        self.clock = WALL

    def seal(self, datagrams: list[bytes], now: float) -> list[bytes]:
        return [sealed for datagram in datagrams for sealed in self.envelope.seal(datagram, now)]

    def announce(self, now: float) -> list[bytes]:
        return self.seal(
            self.publisher.announce(SPEED, "speed", FIELDS, now=now, wall_ticks=self.clock),
            now,
        )

    def speed(self, value: float, now: float) -> list[bytes]:
        if self.clock == WALL:
            self.publisher.announce(SPEED, "speed", FIELDS, now=now, wall_ticks=self.clock)
        self.clock += 1
        return self.seal(self.publisher.publish(SPEED, (value,), timestamp=self.clock, now=now), now)


class _Once:
    """Reservations of a sender that is made anew in a test: they go on."""

    given = 0

    def reserve(self, group_id: str, token_id: int, count: int) -> int:
        del group_id, token_id
        _Once.given += count
        return _Once.given + 1 - count


class Server:
    def __init__(self, policy: UnknownSources = UnknownSources.CREATE, mode: SecurityMode = ENCRYPT) -> None:
        self.counters = Counters()
        opener = Envelope(0, self.counters, mode=mode, nonces=_Once())
        if mode is not NONE:
            opener.install("t-2", group_keys(seed="t-2", next_s=1e6, lifetime_s=1e6), 0.0)
        self.subscriber = Subscriber(0, PubSubTiming(), self.counters, CODEC, envelope=opener, random=Random(1))
        self.state = FleetState(fleet_model(fleet_config()), self.counters, unknown_sources=policy)
        self.events: list[SubscriberEvent] = []

    def receive(self, datagrams: list[bytes], now: float) -> list[Change]:
        return self.apply([event for datagram in datagrams for event in self.subscriber.receive(datagram, now)])

    def poll(self, now: float) -> list[Change]:
        return self.apply(self.subscriber.poll(now))

    def apply(self, events: list[SubscriberEvent]) -> list[Change]:
        self.events += events
        return [change for event in events for change in self.state.apply(event, 1000)]


def speed_of(changes: list[Change]) -> list[tuple[object, int]]:
    """Each value and status that the node of the speed got."""
    return [values([change])[1001][:2] for change in changes if 1001 in values([change])]


def alive(now: float = 0.0) -> tuple[Server, Robot]:
    server, robot = Server(), Robot()
    server.receive(robot.announce(now), now)
    assert speed_of(server.receive(robot.speed(1.5, now), now)) == [(1.5, 0)]
    return server, robot


FORGERIES = {
    "wrong key": (lambda: Robot(keys="wrong"), Drop.BAD_SIGNATURE),
    "only signed": (lambda: Robot(SIGN), Drop.NOT_SECURED),
    "plain": (lambda: Robot(NONE), Drop.NOT_SECURED),
}


@pytest.mark.parametrize(("make", "drop"), FORGERIES.values(), ids=FORGERIES.keys())
def test_a_configured_source_that_was_never_heard_says_why(make: type[Robot], drop: Drop) -> None:
    server, forger = Server(), make()
    changes = server.receive(forger.announce(0.0) + forger.speed(9.9, 0.0), 0.0)
    assert speed_of(changes) == [(None, REFUSED)]
    assert only(SourceRefused, server.events) == [SourceRefused(SPEED, drop)]
    text = f"messages in its name are refused ({drop.value}): its nodes are Bad_SecurityChecksFailed"
    assert notices(changes) == [f"ua_2_2_1001 (speed): {text}"]
    assert speed_of(server.receive(forger.speed(9.9, 1.0), 1.0)) == []
    robot = Robot()
    changes = server.receive(robot.announce(2.0) + robot.speed(1.5, 2.0), 2.0)
    assert speed_of(changes) == [(None, StatusCode.BAD_WAITING_FOR_INITIAL_DATA), (1.5, 0)]
    assert "ua_2_2_1001 (speed): its messages are taken again" in notices(changes)
    assert server.counters.drops[drop] == 4


@pytest.mark.parametrize(("make", "drop"), FORGERIES.values(), ids=FORGERIES.keys())
def test_forged_messages_never_take_a_good_value_down(make: type[Robot], drop: Drop) -> None:
    server, robot = alive()
    forger = make()
    for step in range(1, 100):
        now = step / 10
        changes = server.receive(forger.speed(9.9, now), now)
        assert speed_of(changes) == []
        if step % 10 == 0:
            changes = server.receive(robot.seal(robot.publisher.poll(now), now), now) + server.poll(now)
            assert speed_of(changes) == []
    assert server.counters.drops[drop] == 99
    assert only(SourceRefused, server.events) == []


def test_a_source_that_falls_silent_says_refused_once_it_is_and_comes_back_by_itself() -> None:
    server, robot = alive()
    assert speed_of(server.poll(3.0)) == [(1.5, NO_COMMUNICATION)]
    forger = Robot(keys="wrong")
    changes = server.receive(forger.speed(9.9, 3.5), 3.5)
    assert speed_of(changes) == [(1.5, REFUSED)], "the last value stays"
    assert speed_of(server.receive(forger.speed(9.9, 3.6), 3.6)) == []
    changes = server.receive(robot.seal(robot.publisher.poll(4.0), 4.0), 4.0)
    assert speed_of(changes) == [(1.5, 0)]
    assert "ua_2_2_1001 (speed): its messages are taken again" in notices(changes)
    assert speed_of(server.poll(7.0)) == [(1.5, NO_COMMUNICATION)]
    assert speed_of(server.receive(forger.speed(9.9, 7.0), 7.0)) == [(1.5, REFUSED)], "told again"
    assert [type(event) for event in server.events if not isinstance(event, MetaDataReceived)] == [
        SourceAppeared,
        DataReceived,
        SourceSilent,
        SourceRefused,
        SourceReturned,
        SourceSilent,
        SourceRefused,
    ]


def test_a_replay_of_a_silent_source_is_seen() -> None:
    server, robot = alive()
    sealed = robot.speed(2.0, 0.5)
    server.receive(sealed, 0.5)
    server.poll(5.0)
    assert speed_of(server.receive(sealed, 5.0)) == [(2.0, REFUSED)]
    assert server.counters.drops == {Drop.REPLAYED: 1}


@pytest.mark.parametrize("policy", UnknownSources)
def test_unknown_sources_never_become_nodes_from_refused_messages(policy: UnknownSources) -> None:
    server = Server(policy)
    for forger in (Robot(NONE), Robot(SIGN), Robot(keys="wrong")):
        stranger = Topic(2, 2, 7777)
        datagrams = forger.publisher.announce(stranger, "stranger", FIELDS, now=0.0, wall_ticks=WALL)
        datagrams += forger.publisher.publish(stranger, (1.0,), timestamp=WALL, now=0.0)
        assert server.receive(forger.seal(datagrams, 0.0), 0.0) == []
    assert set(map(type, server.events)) == {SourceRefused}
    assert server.subscriber.writers == {}


def test_an_unsigned_announcement_never_makes_a_node_or_changes_a_version() -> None:
    server, robot = alive()
    plain = Robot(NONE)
    for version in (1, 2, 0xFFFF_FFFF):
        forged = [announcement(2, version)]
        forged += plain.publisher.announce(Topic(2, 2, 1001), "forged", (), now=0.0, wall_ticks=WALL + version)
        forged += plain.publisher.announce(Topic(2, 2, 7777), "forged", FIELDS, now=0.0, wall_ticks=WALL)
        assert [c for c in server.receive(forged, 1.0) if isinstance(c, SourceAdded | SourceQuarantined)] == []
    writer = server.subscriber.writers[SPEED]
    assert writer.metadata is not None
    assert (writer.metadata.fields, len(server.subscriber.writers)) == (FIELDS, 1)
    changes = server.receive(robot.speed(1.9, 2.0), 2.0)
    assert speed_of(changes) == [(1.9, 0)], "messages still fit the version that was signed"
    assert set(server.counters.drops) == {Drop.NOT_SECURED}


def test_without_keys_configured_nothing_is_refused() -> None:
    server, robot = Server(mode=NONE), Robot(NONE)
    server.receive(robot.announce(0.0), 0.0)
    assert speed_of(server.receive(robot.speed(1.5, 0.0), 0.0)) == [(1.5, 0)]
    secured = Robot().envelope.seal(data(publisher_id=2), 0.0)
    assert server.receive(secured, 0.0) == []
    assert server.counters.drops == {Drop.SECURED: 1}


def test_own_data_that_comes_back_counts_as_a_loop_and_as_received() -> None:
    robot = Robot()
    counters = Counters()
    subscriber = Subscriber(2, PubSubTiming(), counters, CODEC, envelope=robot.envelope)
    sealed = robot.announce(0.0) + robot.speed(1.0, 0.0)
    assert [event for datagram in sealed for event in subscriber.receive(datagram, 0.0)] == []
    assert counters.drops == {Drop.LOOP: 3}
    assert counters.messages_in == 2, "an announcement is no DataSetMessage"
    assert subscriber.complaints(0.0) == []


def test_refused_commands_say_nothing_of_sources() -> None:
    opener = envelope(1, "c-1")
    subscriber = Subscriber(1, PubSubTiming(), Counters(), CODEC, envelope=opener)
    forged = one(envelope(2, "c-1", seed="wrong").seal(action(), 0.0))
    assert subscriber.receive(forged, 0.0) == []
    assert [complaint.cause for complaint in subscriber.complaints(0.0)] == ["bad_signature"]


def test_refused_messages_are_told_once_a_minute_for_each_cause_with_a_remedy() -> None:
    server = Server()
    for now in (0.0, 1.0, 2.0):
        for forger in (Robot(NONE), Robot(keys="wrong")):
            server.receive(forger.speed(1.0, now), now)
    complaints = server.subscriber.complaints(2.0)
    assert [(said.what, said.cause, said.count) for said in complaints] == [
        ("refused messages", "not_secured", 3),
        ("refused messages", "bad_signature", 3),
    ]
    plain, wrong = (said.detail for said in complaints)
    assert plain.endswith("is not signed and encrypted; give it the same `pubsub.security` as this process")
    assert wrong.startswith(
        "bad_signature: PublisherId 2, token 1 of t-2: not signed with our key; give both their keys"
    )
    server.receive([data(publisher_id=2)], 30.0)
    assert server.subscriber.complaints(61.9) == []
    assert [said.count for said in server.subscriber.complaints(62.0)] == [1]


def test_memory_under_forged_messages_of_all_the_world() -> None:
    server = Server()
    random = Random(1)
    ids = range(1, 0x10000)
    forged = [data(publisher_id=random.choice(ids), writer_id=random.choice(ids)) for _ in range(13_000)]
    tracemalloc.start()
    try:
        for datagram in forged[:3_000]:
            server.subscriber.receive(datagram, 0.0)
        before = tracemalloc.get_traced_memory()[0]
        for datagram in forged[3_000:]:
            server.subscriber.receive(datagram, 0.0)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 50_000
    assert server.counters.drops == {Drop.NOT_SECURED: 13_000}
    assert server.subscriber.writers == {}


def test_the_state_never_takes_down_a_source_that_lives() -> None:
    """Also should somebody tell it so."""
    fleet = Fleet()
    fleet.speed(0.5)
    assert fleet.state.apply(SourceRefused(SPEED, Drop.BAD_SIGNATURE), fleet.now) == []
    assert fleet.state.apply(SourceRefused(Topic(9, 9, 9), Drop.BAD_SIGNATURE), fleet.now) == []


def test_all_fields_of_a_refused_source_say_so_and_it_is_told_once() -> None:
    fleet = Fleet()
    pose = Topic(2, 2, 1003)
    changes = fleet.state.apply(SourceRefused(pose, Drop.REPLAYED), fleet.now)
    statuses = {key: status for key, (_, status, _) in values(changes).items()}
    assert statuses == {"1003.x": REFUSED, "1003.frame": REFUSED}
    assert [change.is_problem for change in changes if isinstance(change, Noticed)] == [True]
    assert fleet.state.apply(SourceRefused(pose, Drop.REPLAYED), fleet.now) == []
