"""The loop rule over several connections: bridges that stand on any of them, and brokers that repeat, reorder and keep.

Between two of the connections there may be a relay. It forwards what the bridges of one of them say to the other one,
in both directions at once, and it may be killed and started again at any time.

A connection is a multicast group, or a broker. A broker delivers again what was published within the last seconds, as a
message that is fresh (QoS 1 says "at least once"), whatever it has ever heard as one that it has kept, and tells of the
end of a bridge that lives.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random
from typing import Final

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.test_loop_rule import COMMAND, ECHO_ID, START_NS, TIMING, Loop, OnBus, Plan, VirtualBridge, World
from ua_fleet.bridge import BridgeCore, Rule
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.events import DataReceived, ProbeReceived
from ua_fleet.pubsub.origins import NO_ORIGINS, Direction, Origins
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.relay import Forwarded, RelayCore, RelayedConnection
from ua_fleet.topics import SERVER_SPACE, LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.transport.memory import MemoryNetwork
from ua_fleet.wire import Codec, encode_announcement
from ua_fleet.wire.discovered import PubSubState, StatusAnnouncement
from ua_fleet.wire.messages import NetworkMessage, Probe, PublisherIdType
from ua_fleet.wire.security import SecurityMode

REPEATED_WITHIN_S: Final = 2.0
_CODEC: Final = Codec()

Hear = Callable[[bytes, bool], None]
"""Takes a datagram; whether it is fresh."""


@dataclass(frozen=True)
class Way:
    """One connection, and what it does to messages."""

    is_broker: bool
    loss: float
    duplicate: float
    max_delay_s: float


class Link:
    """One connection. A broker haunts: see the module."""

    def __init__(self, way: Way, seed: int) -> None:
        self.way = way
        self.random = Random(seed)
        self.network = MemoryNetwork(
            seed, loss=0.0 if way.is_broker else way.loss, duplicate=way.duplicate, max_delay_s=way.max_delay_s
        )
        self._members: list[Hear] = []
        self._published: deque[tuple[float, bytes]] = deque()
        self._kept: list[bytes] = []

    def join(self, hear: Hear) -> Callable[[bytes], None]:
        """Become a member; how it sends."""
        endpoint = self.network.endpoint()
        endpoint.attach(lambda datagram, _: hear(datagram, True))
        self._members.append(hear)

        def send(datagram: bytes) -> None:
            self._published.append((self.network.now, datagram))
            self._kept.append(datagram)
            endpoint.send(datagram)

        return send

    def haunt(self, wills: list[bytes]) -> None:
        """Say something again, as brokers do."""
        while self._published and self._published[0][0] < self.network.now - REPEATED_WITHIN_S:
            self._published.popleft()
        if not self.way.is_broker or not self._members or self.random.random() < 0.5:
            return
        hear = self.random.choice(self._members)
        if self._published:
            hear(self.random.choice(self._published)[1], True)
        if self._kept:
            hear(self.random.choice(self._kept), False)
        if wills and self.random.random() < 0.1:
            hear(self.random.choice(wills), False)


@dataclass(frozen=True)
class Roads:
    """A world over several connections."""

    plan: Plan
    ways: tuple[Way, ...]
    on: dict[int, tuple[int, ...]]
    """The connections of each bridge. The server is on all."""
    between: tuple[int, int] | None = None
    """The two connections that a relay is on."""

    def brought(self, source: int, target: int) -> Origins:
        """What a relay brings from one connection to another: the spaces that are on the first alone of the two."""
        if self.between not in ((source, target), (target, source)):
            return NO_ORIGINS
        return Origins([space for space, on in self.on.items() if source in on and target not in on])

    def relayed(self, connection: int) -> Origins:
        """What comes by a connection by the relay."""
        if self.between is None or connection not in self.between:
            return NO_ORIGINS
        return self.brought(sum(self.between) - connection, connection)


class RoadBridge(VirtualBridge):
    """A bridge on some connections. What it sends must be of its own space."""

    def __init__(self, world: RoadWorld, space: int, on: tuple[int, ...]) -> None:
        self.space, self._world = space, world
        self.counters = Counters()
        self._known: set[Topic] = set()
        codec = Codec()
        first, *further = map(world.roads.relayed, on)
        subscriber = Subscriber(space, TIMING, self.counters, codec, world.rule, random=world.random, relayed=first)
        for relayed in further:
            subscriber.add_connection(None, relayed=relayed)
        sends: list[Callable[[bytes], None]] = []

        def send(datagram: bytes) -> None:
            message = _CODEC.decode(datagram)
            if isinstance(message, NetworkMessage) and message.publisher_id != space:
                raise Loop(f"the bridge of space {space} sends data of {message.publisher_id}")
            for each in sends:
                each(datagram)

        self.core = BridgeCore(
            space,
            Publisher(space, TIMING, self.counters, codec),
            subscriber,
            self.counters,
            send=send,
            publish=self._publish,
            rule=world.rule,
        )
        for number, connection in enumerate(on):
            sends.append(world.links[connection].join(self._hearing(number)))

    def _hearing(self, number: int) -> Hear:
        def hear(datagram: bytes, is_fresh: bool) -> None:
            now = self._world.network.now
            self.core.from_pubsub(datagram, now=now, is_fresh=is_fresh, connection=number)

        return hear


class VirtualRelay:
    """A relay on two connections. What it sends to one must be of the other."""

    goes_back = False
    """Whether it is configured wrongly, as no `fleet.yaml` may be: each origin goes in both directions."""

    def __init__(self, world: RoadWorld, between: tuple[int, int]) -> None:
        self._world, self._between = world, between
        self.counters = Counters()
        self.core = self._made()
        self._sends = [world.links[number].join(self._hearing(place)) for place, number in enumerate(between)]
        self._send(self.core.begin())

    def _made(self) -> RelayCore:
        roads = self._world.roads
        connections = [
            RelayedConnection(
                Envelope(254, self.counters, mode=SecurityMode.NONE, nonces=MemoryNonces(), speaks_under="r-gate"),
                roads.ways[number].is_broker,
            )
            for number in self._between
        ]
        one, other = self._between
        there, back = roads.brought(one, other), roads.brought(other, one)
        if self.goes_back:
            there = back = there | back
        directions = [Direction(0, 1, there), Direction(1, 0, back)]
        return RelayCore(
            connections,
            directions,
            self.counters,
            Codec(),
            receive_timeout_s=TIMING.receive_timeout_s,
            random=self._world.random,
        )

    def restart(self) -> None:
        """Be killed, and started again: all that it knew is gone."""
        self.core = self._made()
        self._send(self.core.begin())

    def _hearing(self, place: int) -> Hear:
        def hear(datagram: bytes, is_fresh: bool) -> None:
            self._send(self.core.receive(place, datagram, self._world.network.now, is_fresh=is_fresh))

        return hear

    def poll(self, now: float) -> None:
        self._send(self.core.poll(now))

    def _send(self, forwarded: list[Forwarded]) -> None:
        for place, plain in forwarded:
            message = _CODEC.decode(plain)
            target = self._between[place]
            of_target = self._world.roads.relayed(target).publishers
            if not isinstance(message, Probe) and message.publisher_id not in of_target:
                raise Loop(f"the relay sends data of {message.publisher_id} to connection {target}")
            self._sends[place](plain)


class RoadWorld(World):
    """Bridges on their connections, and the server on all."""

    def __init__(self, roads: Roads, rule: Rule = loop_verdict) -> None:
        self.roads, self.plan, self.rule = roads, roads.plan, rule
        self.links = [Link(way, roads.plan.seed + number) for number, way in enumerate(roads.ways)]
        self.network = self.links[0].network  # whose clock is that of all
        self.delivered = Counter()
        self.payloads = {}
        self.from_robots = {}
        self.random = Random(roads.plan.seed)
        self._bus: deque[tuple[int, OnBus]] = deque()
        self._last_time_ns = START_NS
        self._events = 0
        self.heard: dict[Topic, list[int]] = {}
        """The Timestamps of what the server took, by source."""
        self.bridges = [RoadBridge(self, space, on) for space, on in roads.on.items()]
        self._server = Publisher(SERVER_SPACE, TIMING, Counters(), Codec())
        first, *further = map(roads.relayed, range(len(self.links)))
        self.subscriber = Subscriber(SERVER_SPACE, TIMING, Counters(), Codec(), random=self.random, relayed=first)
        for relayed in further:
            self.subscriber.add_connection(None, relayed=relayed)
        self.relay = None if roads.between is None else VirtualRelay(self, roads.between)
        self._lines = [link.join(self._served(number)) for number, link in enumerate(self.links)]
        self.wills = [
            encode_announcement(
                StatusAnnouncement(space, PublisherIdType.UINT16.value, 0, False, PubSubState.ERROR.value)
            )
            for space in roads.on
        ]

    def _served(self, number: int) -> Hear:
        def hear(datagram: bytes, is_fresh: bool) -> None:
            for event in self.subscriber.receive(datagram, self.network.now, is_fresh=is_fresh, connection=number):
                if isinstance(event, ProbeReceived):
                    self._send(self._server.answer(event.probe, self.network.now))
                elif isinstance(event, DataReceived):
                    self.heard.setdefault(event.topic, []).append(event.message.timestamp or 0)
                elif (probe := getattr(event, "datagram", None)) is not None:
                    self._send([probe])

        return hear

    def _send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            for send in self._lines:
                send(datagram)

    def run_until(self, end: float) -> None:
        """Let time pass; whatever is due happens at its time, and brokers haunt."""
        while True:
            due = [
                *(link.network.next_delivery() for link in self.links),
                self._server.next_deadline(),
                self.subscriber.next_deadline(),
                None if self.relay is None else self.relay.core.next_deadline(),
                *(bridge.core.next_deadline() for bridge in self.bridges),
                self.network.now + 0.25,
            ]
            at = max(min(time for time in due if time is not None), self.network.now)
            if at >= end:
                break
            self._advance(at)
            self._send(self._server.poll(at))
            for event in self.subscriber.poll(at):
                if (probe := getattr(event, "datagram", None)) is not None:
                    self._send([probe])
            if self.relay is not None:
                self.relay.poll(at)
            for bridge in self.bridges:
                deadline = bridge.core.next_deadline()
                if deadline is not None and deadline <= at:
                    bridge.core.poll(at)
            for link in self.links:
                link.haunt(self.wills)
            self._settle_buses()
        self._advance(end)

    def _advance(self, at: float) -> None:
        for link in self.links:
            link.network.advance_to(at)
        self._settle_buses()

    def share(self, one: int, other: int) -> bool:
        """Whether what one bridge says reaches another: by a connection that both are on, or by the relay."""
        reached = set(self.roads.on[one])
        reached |= {number for number in range(len(self.links)) if self.roads.relayed(number).names(one)}
        return not reached.isdisjoint(self.roads.on[other])


def live(world: RoadWorld) -> None:
    """Everybody says what is planned, then nothing is lost any more; at last nothing may travel."""
    for number, (space, pause) in enumerate(world.plan.says):
        world.run_until(world.network.now + pause)
        if world.relay is not None and world.random.random() < 0.3:
            world.relay.restart()
        world.say(space, number)
    for link in world.links:
        link.network.loss = 0.0
    world.run_until(world.network.now + 6 * TIMING.repeat_interval_s)
    before = world.travelled()
    world.wills = []
    world.run_until(world.network.now + 3 * TIMING.repeat_interval_s)
    if world.travelled() != before:
        raise Loop("messages travel though nobody says anything")


def check(world: RoadWorld) -> None:
    """What must be true after any life of a world."""
    live(world)
    for (space, topic, _), count in world.delivered.items():
        if count > 1 or topic.space == space:
            raise Loop(f"{topic.name} came {count} times into space {space}")
        if topic.space != SERVER_SPACE and not world.share(topic.space, space):
            raise Loop(f"{topic.name} came into space {space}, which is on none of its connections")
        if topic.id == ECHO_ID:
            raise Loop(f"what a bridge brought into space {topic.space} came out again")
    for bridge in world.bridges:
        if bridge.counters.looped:
            raise Loop(f"space {bridge.space} counts {bridge.counters.looped} looped deliveries")
    for (space, topic), payloads in world.payloads.items():
        assert payloads == sorted(set(payloads)), f"{topic.name} in space {space}: {payloads}"
    for topic, said in world.from_robots.items():
        for space in world.roads.on:
            if space != topic.space and (topic.space == SERVER_SPACE or world.share(topic.space, space)):
                assert world.payloads[space, topic][-1] == said[-1], f"{topic.name} is not up to date in {space}"
    check_server(world)


def check_server(world: RoadWorld) -> None:
    """What the server has taken, and that it knows who lives."""
    for topic, timestamps in world.heard.items():
        assert timestamps == sorted(set(timestamps)), f"the server took {topic.name} twice, or an older value"
        assert topic.space != SERVER_SPACE
    for topic in world.from_robots:
        if topic.space != SERVER_SPACE:
            writer = world.subscriber.writers[topic]
            assert not writer.silent, f"{topic.name} is silent though its bridge lives"
            assert writer.handed_on == world.heard[topic][-1]


SPACES: Final = (1, 2, 3, 42, 256)


@st.composite
def roads(draw: st.DrawFn) -> Roads:
    ways = tuple(
        draw(
            st.lists(
                st.builds(
                    Way,
                    is_broker=st.booleans(),
                    loss=st.sampled_from([0.0, 0.1, 0.3]),
                    duplicate=st.sampled_from([0.0, 0.2]),
                    max_delay_s=st.sampled_from([0.0, 0.005, 0.3, 0.9]),
                ),
                min_size=2,
                max_size=4,
            )
        )
    )
    spaces = draw(st.lists(st.sampled_from(SPACES), min_size=1, max_size=4, unique=True))
    any_of = st.lists(st.sampled_from(range(len(ways))), min_size=1, max_size=len(ways), unique=True)
    on = {space: tuple(draw(any_of)) for space in spaces}
    pauses = st.sampled_from([0.0, 0.001, 0.02, 0.7])
    says = draw(st.lists(st.tuples(st.sampled_from([SERVER_SPACE, *spaces]), pauses), min_size=1, max_size=8))
    plan = Plan(dict.fromkeys(spaces, 1), draw(st.integers(0, 2**16)), 0.0, 0.0, 0.0, tuple(says))
    pair = st.lists(st.sampled_from(range(len(ways))), min_size=2, max_size=2, unique=True)
    between = draw(st.none() | pair.map(lambda found: (found[0], found[1])))
    return Roads(plan, ways, on, between)


@settings(max_examples=90)
@given(roads())
def test_nothing_loops_nothing_comes_twice_and_the_newest_stands(roads: Roads) -> None:
    check(RoadWorld(roads))


QUIET: Final = Way(is_broker=False, loss=0.0, duplicate=0.0, max_delay_s=0.001)
HAUNTED: Final = Way(is_broker=True, loss=0.0, duplicate=0.2, max_delay_s=0.3)
TWO_ROADS: Final = Roads(
    Plan({1: 1, 2: 1}, 1, 0.0, 0.0, 0.0, ((1, 0.0), (0, 0.1), (2, 0.1), (1, 0.7))),
    (QUIET, HAUNTED),
    {1: (0, 1), 2: (1, 0)},
)


def take_from_everybody(side: Side, origin: int, own_space: int, own_publication: bool) -> LoopVerdict:
    """A rule that takes what comes by PubSub, whoever sent it."""
    return LoopVerdict.TO_SPACE if side is Side.PUBSUB else loop_verdict(side, origin, own_space, own_publication)


def send_whatever_is_heard(side: Side, origin: int, own_space: int, own_publication: bool) -> LoopVerdict:
    """A rule that sends what the space has, wherever it is from."""
    return LoopVerdict.TO_PUBSUB if side is Side.SPACE else loop_verdict(side, origin, own_space, own_publication)


@pytest.mark.parametrize("rule", [take_from_everybody, send_whatever_is_heard])
def test_over_two_connections_a_broken_rule_is_seen(rule: Rule) -> None:
    check(RoadWorld(TWO_ROADS))
    with pytest.raises(Loop):
        check(RoadWorld(TWO_ROADS, rule))


def test_both_roads_carry_and_the_doubles_are_counted() -> None:
    world = RoadWorld(TWO_ROADS)
    check(world)
    assert COMMAND in world.from_robots
    for bridge in world.bridges:
        drops = bridge.counters.drops
        assert drops["duplicate"] + drops["repeated"] > 0
        assert drops["loop"] > 0
        assert drops["retained"] > 0


APART: Final = Roads(
    Plan({1: 1, 2: 1}, 1, 0.0, 0.0, 0.0, ((1, 0.0), (0, 0.1), (2, 0.1), (1, 0.7))),
    (QUIET, HAUNTED),
    {1: (0,), 2: (1,)},
    between=(0, 1),
)


def test_by_a_relay_two_bridges_hear_each_other_that_have_no_connection_in_common() -> None:
    world = RoadWorld(APART)
    check(world)
    assert world.share(1, 2)
    assert world.relay is not None
    assert world.relay.counters.messages_out > 0
    assert {space for space, topic in world.payloads if topic.space != SERVER_SPACE} == {1, 2}
    assert world.relay.counters.drops[Drop.NOT_LISTED] > 0  # the server's
    without = RoadWorld(replace(APART, between=None))
    check(without)
    assert not without.share(1, 2)


@pytest.mark.parametrize("rule", [take_from_everybody, send_whatever_is_heard])
def test_with_a_relay_a_broken_rule_is_seen(rule: Rule) -> None:
    with pytest.raises(Loop):
        check(RoadWorld(APART, rule))


def test_a_relay_that_forwards_back_what_it_has_brought_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(VirtualRelay, "goes_back", True)
    with pytest.raises(Loop, match="the relay sends data of"):
        check(RoadWorld(APART))
