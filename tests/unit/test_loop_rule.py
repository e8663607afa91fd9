"""The loop rule over random worlds: spaces, bridges and a network that loses, delays and duplicates."""

from __future__ import annotations

import functools
from collections import Counter, deque
from dataclasses import dataclass
from random import Random
from typing import Final, NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ua_fleet.bridge import BridgeCore, Rule, SampleRead, SourceFound
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.topics import SERVER_SPACE, LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.transport.memory import MemoryNetwork
from ua_fleet.values import BuiltinType, ticks_from_unix_ns
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

TIMING: Final = PubSubTiming(keep_alive_s=1.0, receive_timeout_s=3.0, repeat_interval_s=2.0)
START_NS: Final = 1_700_000_000_000_000_000
FIELDS: Final = (make_field("data", BuiltinType.INT64, properties={"RosType": "std_msgs/Int64"}),)
COMMAND: Final = Topic(SERVER_SPACE, 2, 500)
"""What clients write in the server. In every space it goes to the robots' own topic /command as well, ..."""
ECHO_ID: Final = 501
"""... which is also mapped the other way, as a source of the space: its name does not tell where its data is from."""


class Loop(AssertionError):
    """More has happened than can without a loop."""


@dataclass(frozen=True)
class Plan:
    """A world: which spaces with how many active bridges, what the network does, and who says something when."""

    bridges: dict[int, int]
    seed: int
    loss: float
    duplicate: float
    max_delay_s: float
    says: tuple[tuple[int, float], ...]
    """(space, pause before in seconds); the server's space is 0."""

    @property
    def most_windows(self) -> int:
        """In one of so many windows at the end nothing may travel.

        Two bridges of a space that bring each other a command last say two values under one DataSetWriter, each with
        its own sequence numbers: a reader that follows the one takes the other half a minute later. A loop never ends.
        """
        return 1 if max(self.bridges.values()) == 1 else 10


class OnBus(NamedTuple):
    """A message on the bus of a space."""

    name: str
    payload: int
    source_time_ns: int
    publisher: VirtualBridge | None
    """None for a robot."""


class VirtualBridge:
    """A core between the bus of its space and the network. It tells its core everything that it hears."""

    def __init__(self, world: World, space: int) -> None:
        self.space, self._world = space, world
        self.counters = Counters()
        self._known: set[Topic] = set()
        endpoint = world.network.endpoint()
        codec = Codec()
        self.core = BridgeCore(
            space,
            Publisher(space, TIMING, self.counters, codec),
            Subscriber(space, TIMING, self.counters, codec, world.rule, random=world.random),
            self.counters,
            send=endpoint.send,
            publish=self._publish,
            rule=world.rule,
        )
        endpoint.attach(lambda datagram, _: self.core.from_pubsub(datagram, now=world.network.now))

    def _publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        payload = message.values[0]
        assert message.timestamp is not None
        self._world.delivered[self.space, topic, message.timestamp] += 1
        self._world.payloads.setdefault((self.space, topic), []).append(payload)
        self._world.put(self.space, topic.name, payload, self)
        if topic == COMMAND:
            self._world.put(self.space, "/command", payload, self)
        return True

    def hear(self, message: OnBus) -> None:
        """Tell the core what is on the bus."""
        own = message.publisher is self
        topic = Topic(self.space, 2, ECHO_ID) if message.name == "/command" else Topic.parse(message.name)
        now, wall = self._world.network.now, self._world.wall_ticks()
        if topic not in self._known:
            self._known.add(topic)
            self.core.from_space(SourceFound(topic, message.name, FIELDS), now=now, wall_ticks=wall)
        sample = SampleRead(topic, (message.payload,), message.source_time_ns, own_publication=own)
        self.core.from_space(sample, now=now, wall_ticks=wall)


class World:
    """Spaces, bridges and the server. Time stands still unless `run_until` moves it."""

    def __init__(self, plan: Plan, rule: Rule = loop_verdict) -> None:
        self.plan, self.rule = plan, rule
        self.network = MemoryNetwork(plan.seed, loss=plan.loss, duplicate=plan.duplicate, max_delay_s=plan.max_delay_s)
        self.delivered: Counter[tuple[int, Topic, int]] = Counter()
        """How often bridges published each (origin, writer, source timestamp) into each space."""
        self.payloads: dict[tuple[int, Topic], list[int]] = {}
        self.from_robots: dict[Topic, list[int]] = {}
        self.random = Random(plan.seed)
        self._bus: deque[tuple[int, OnBus]] = deque()
        self._last_time_ns = START_NS
        self._events = 0
        self.bridges = [VirtualBridge(self, space) for space, count in plan.bridges.items() for _ in range(count)]
        self._server_line = self.network.endpoint()
        self._server = Publisher(SERVER_SPACE, TIMING, Counters(), Codec())
        subscriber = Subscriber(SERVER_SPACE, TIMING, Counters(), Codec(), random=self.random)
        self._server_line.attach(lambda datagram, _: self._answer(subscriber, datagram))

    def _answer(self, subscriber: Subscriber, datagram: bytes) -> None:
        for event in subscriber.receive(datagram, self.network.now):
            if (probe := getattr(event, "probe", None)) is not None:
                self._send(self._server.answer(probe, self.network.now))

    def _send(self, datagrams: list[bytes]) -> None:
        for datagram in datagrams:
            self._server_line.send(datagram)

    def wall_ticks(self) -> int:
        return ticks_from_unix_ns(self._wall_ns())

    def _wall_ns(self) -> int:
        return START_NS + int(self.network.now * 1e9)

    def put(self, space: int, name: str, payload: int, publisher: VirtualBridge | None) -> None:
        """Put a message on the bus of a space; each has a time of its own."""
        self._last_time_ns = max(self._wall_ns(), self._last_time_ns + 100) // 100 * 100
        self._bus.append((space, OnBus(name, payload, self._last_time_ns, publisher)))

    def say(self, space: int, payload: int) -> None:
        """A robot of a space, or a client of the server, says something."""
        if space == SERVER_SPACE:
            self.from_robots.setdefault(COMMAND, []).append(payload)
            now, ticks = self.network.now, self.wall_ticks()
            if self._server.metadata(COMMAND) is None:
                self._send(self._server.announce(COMMAND, "command", FIELDS, now=now, wall_ticks=ticks))
            self._send(self._server.publish(COMMAND, (payload,), timestamp=ticks, now=now))
        else:
            topic = Topic(space, 2, 1000 + payload % 2)
            self.from_robots.setdefault(topic, []).append(payload)
            self.put(space, topic.name, payload, None)
        self._settle_buses()

    def _settle_buses(self) -> None:
        most = 200 * len(self.plan.says) * len(self.bridges)
        while self._bus:
            self._events += 1
            if self._events > most:
                raise Loop("messages travel for ever on the buses")
            space, message = self._bus.popleft()
            for bridge in self.bridges:
                if bridge.space == space:
                    bridge.hear(message)

    def run_until(self, end: float) -> None:
        """Let time pass; whatever is due happens at its time."""
        while True:
            due = [
                self.network.next_delivery(),
                self._server.next_deadline(),
                *(b.core.next_deadline() for b in self.bridges),
            ]
            at = max(min((time for time in due if time is not None), default=end), self.network.now)
            if at >= end:
                break
            self.network.advance_to(at)
            self._settle_buses()
            self._send(self._server.poll(at))
            for bridge in self.bridges:
                deadline = bridge.core.next_deadline()
                if deadline is not None and deadline <= at:
                    bridge.core.poll(at)
            self._settle_buses()
        self.network.advance_to(end)
        self._settle_buses()

    def travelled(self) -> list[tuple[int, int, int]]:
        """What has passed each bridge."""
        return [(b.counters.from_space, b.counters.to_space, b.counters.looped) for b in self.bridges]


def live(world: World) -> None:
    """Everybody says what is planned, then the network becomes perfect; at last nothing may travel any more."""
    for number, (space, pause) in enumerate(world.plan.says):
        world.run_until(world.network.now + pause)
        world.say(space, number)
    world.network.loss = 0.0
    world.run_until(world.network.now + 12 * TIMING.repeat_interval_s)
    for _ in range(world.plan.most_windows):
        before = world.travelled()
        world.run_until(world.network.now + 3 * TIMING.repeat_interval_s)
        if world.travelled() == before:
            return
    raise Loop("messages travel though nobody says anything")


def check(world: World) -> None:
    """What must be true after any life of a world."""
    live(world)
    active = world.plan.bridges
    for (space, topic, _), count in world.delivered.items():
        if count > active[space]:
            raise Loop(f"{topic.name} came {count} times into space {space} with {active[space]} bridges")
        if topic.space == space:
            raise Loop(f"{topic.name} came back into its space")
    for bridge in world.bridges:
        if bridge.counters.looped:
            raise Loop(f"space {bridge.space} counts {bridge.counters.looped} looped deliveries")
        if bridge.counters.drops[Drop.CONVERSION]:
            raise Loop(f"space {bridge.space} tried to send another space's data")
    for (space, topic), payloads in world.payloads.items():
        if topic.id == ECHO_ID and active[topic.space] == 1:
            raise Loop(f"what a bridge brought into space {topic.space} came out again as {topic.name} ({payloads})")
        if active[space] == 1 and topic.id != ECHO_ID:
            assert payloads == sorted(set(payloads)), f"{topic.name} in space {space}: {payloads}"
    for topic, said in world.from_robots.items():
        for space in active:
            if space != topic.space:
                assert world.payloads[space, topic][-1] == said[-1], f"{topic.name} is not up to date in {space}"


SPACES = (1, 2, 3, 42, 232, 256, 65_535)


@st.composite
def plans(draw: st.DrawFn, most_bridges: int = 3) -> Plan:
    spaces = draw(st.lists(st.sampled_from(SPACES), min_size=1, max_size=6, unique=True))
    bridges = {space: draw(st.integers(1, most_bridges)) for space in spaces}
    speakers = st.sampled_from([SERVER_SPACE, *spaces])
    pauses = st.sampled_from([0.0, 0.001, 0.02, 0.7])
    return Plan(
        bridges,
        seed=draw(st.integers(0, 2**16)),
        loss=draw(st.sampled_from([0.0, 0.1, 0.3])),
        duplicate=draw(st.sampled_from([0.0, 0.2])),
        max_delay_s=draw(st.sampled_from([0.0, 0.005, 0.3])),
        says=tuple(draw(st.lists(st.tuples(speakers, pauses), min_size=1, max_size=12))),
    )


LATE: Final = Plan(
    {1: 3, 2: 3, 3: 3, 42: 1, 232: 2, 256: 2},
    seed=2155,
    loss=0.3,
    duplicate=0.0,
    max_delay_s=0.005,
    says=((1, 0.0), (2, 0.7), (256, 0.0), (2, 0.0), (1, 0.7), (0, 0.7)),
)
"""In which a value comes at 30 s."""


@settings(max_examples=40)
@example(LATE)
@given(plans())
def test_nothing_travels_for_ever_and_nothing_comes_twice(plan: Plan) -> None:
    check(World(plan))


@settings(max_examples=60)
@given(plans(most_bridges=1))
def test_with_one_active_bridge_in_each_space_nothing_is_delivered_twice(plan: Plan) -> None:
    world = World(plan)
    check(world)
    assert set(world.delivered.values()) <= {1}


def forward_always(side: Side, _origin: int, _own_space: int, _own_publication: bool) -> LoopVerdict:
    return LoopVerdict.TO_SPACE if side is Side.PUBSUB else LoopVerdict.TO_PUBSUB


def forward_instead_of(
    wrong: LoopVerdict, side: Side, origin: int, own_space: int, own_publication: bool
) -> LoopVerdict:
    verdict = loop_verdict(side, origin, own_space, own_publication)
    return forward_always(side, origin, own_space, own_publication) if verdict is wrong else verdict


BROKEN: dict[str, Rule] = {
    "always": forward_always,
    "loop": functools.partial(forward_instead_of, LoopVerdict.DROP_LOOP),
    "foreign": functools.partial(forward_instead_of, LoopVerdict.DROP_FOREIGN),
    "own publication": functools.partial(forward_instead_of, LoopVerdict.DROP_OWN),
}
TWO_SPACES = Plan({1: 1, 2: 1}, seed=1, loss=0.0, duplicate=0.0, max_delay_s=0.001, says=((1, 0.0), (0, 0.1), (2, 0.1)))


@pytest.mark.parametrize("broken", BROKEN)
def test_each_cell_of_the_rule_is_needed(broken: str) -> None:
    check(World(TWO_SPACES))
    with pytest.raises(Loop):
        check(World(TWO_SPACES, BROKEN[broken]))


def test_without_the_rule_messages_travel_for_ever_and_bridges_count_them() -> None:
    world = World(TWO_SPACES, forward_always)
    with pytest.raises(Loop, match=r"for ever|nobody says"):
        live(world)
    assert sum(bridge.counters.looped for bridge in world.bridges) > 0


def test_each_sender_hears_its_own_multicast_and_drops_it_as_a_loop() -> None:
    world = World(TWO_SPACES)
    check(world)
    assert all(bridge.counters.drops[Drop.LOOP] > 0 for bridge in world.bridges)
    assert all(bridge.counters.drops[Drop.OWN_PUBLICATION] > 0 for bridge in world.bridges)
    assert all(bridge.counters.drops[Drop.FOREIGN] > 0 for bridge in world.bridges)
