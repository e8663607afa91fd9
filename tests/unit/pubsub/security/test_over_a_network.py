"""Envelopes of several processes over the in-memory network: rotation with clocks that differ, restarts, losses."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.pubsub.security.securing import ENCRYPT, data, group_keys, key_data
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.pubsub.security.nonces import MemoryNonces, NonceReservations
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork
from ua_fleet.wire import SecurityPolicy

LIFETIME = 10.0
FUTURE = 3


def service(group_id: str, now: float) -> GroupKeys:
    """A key service: token n is current from (n - 1) lifetimes on."""
    current = int(now // LIFETIME) + 1
    return group_keys(current, 1 + FUTURE, seed=group_id, next_s=current * LIFETIME - now, lifetime_s=LIFETIME)


class Process:
    """One member of the network, whose clock shows another time, and who hears the service's times wrong."""

    def __init__(
        self,
        network: MemoryNetwork,
        space: int,
        *,
        offset: float = 0.0,
        error: float = 0.0,
        nonces: NonceReservations | None = None,
        endpoint: MemoryEndpoint | None = None,
        max_datagram_bytes: int = 65_507,
    ) -> None:
        self.network, self.offset, self.error, self.space = network, offset, error, space
        self.counters = Counters()
        self.envelope = Envelope(
            space,
            self.counters,
            mode=ENCRYPT,
            nonces=nonces or MemoryNonces(),
            max_datagram_bytes=max_datagram_bytes,
        )
        self.heard: Counter[bytes] = Counter()
        self.refused: Counter[str] = Counter()
        self.arrived: set[bytes] = set()
        """Every datagram that the network has brought."""
        self.endpoint = endpoint or network.endpoint()
        self.endpoint.attach(lambda datagram, _: self.receive(datagram))

    @property
    def now(self) -> float:
        return self.network.now + self.offset

    def fetch(self) -> None:
        """What the keeper does."""
        for group_id in self.envelope.keys_wanted(self.now):
            keys = service(group_id, self.network.now)
            keys = keys._replace(time_to_next_key_s=keys.time_to_next_key_s + self.error)
            self.envelope.install(group_id, keys, self.now)

    def send(self, text: str) -> list[bytes]:
        datagrams = self.envelope.seal(data(text, self.space), self.now)
        for datagram in datagrams:
            self.endpoint.send(datagram)
        return datagrams

    def receive(self, datagram: bytes) -> None:
        self.arrived.add(datagram)
        try:
            plain = self.envelope.open(datagram, self.now)
        except DatagramRefused as refused:
            if refused.drop is not Drop.LOOP:
                self.refused[refused.drop] += 1
        else:
            if plain is not None:
                self.heard[plain] += 1


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32),
    offsets=st.tuples(*[st.floats(-1e6, 1e6)] * 3),
    errors=st.tuples(*[st.floats(-4.0, 4.0)] * 3),
    duplicate=st.sampled_from([0.0, 0.3]),
)
def test_keys_rotate_without_a_message_lost_or_refused(
    seed: int, offsets: tuple[float, ...], errors: tuple[float, ...], duplicate: float
) -> None:
    """Each process changes keys by its own clock, some seconds early or late."""
    network = MemoryNetwork(seed, duplicate=duplicate, max_delay_s=0.2)
    members = [
        Process(network, space, offset=offset, error=error)
        for space, offset, error in zip((1, 2, 3), offsets, errors, strict=True)
    ]
    for member in members:
        for other in (1, 2, 3):
            member.envelope.want(f"t-{other}")
        member.fetch()
        member.send("first")  # what comes before the first message that is heard would be refused
    network.advance_to(1.0)
    sent = 0
    while network.now < 4.5 * LIFETIME:
        for member in members:
            member.fetch()
            member.send(f"{sent}")
        sent += 1
        network.advance_to(network.now + 0.1)
    network.advance_to(network.now + 1.0)
    for member in members:
        expected = {
            data(text, space)
            for space in (1, 2, 3)
            if space != member.space
            for text in ("first", *map(str, range(sent)))
        }
        assert set(member.heard) == expected
        assert set(member.heard.values()) == {1}
        assert member.refused.keys() <= ({Drop.REPLAYED} if duplicate else set())
        assert member.counters.drops == {}


def test_without_the_service_all_goes_on_as_long_as_the_keys_last() -> None:
    network = MemoryNetwork()
    one, other = Process(network, 1), Process(network, 2)
    one.envelope.want("t-2")
    for process in (one, other):
        process.fetch()
    sent = 0
    end = (1 + FUTURE + 2) * LIFETIME  # the keys' lifetimes, and two more for the last one
    while network.now < end:
        other.send(f"{sent}")
        sent += 1
        network.advance_to(network.now + 0.5)
    assert sum(one.heard.values()) == sent
    assert other.counters.drops == {}
    other.send("too late")
    network.advance_to(network.now + 1)
    assert other.counters.drops == {Drop.NO_KEY: 1}
    assert sum(one.heard.values()) == sent
    for process in (one, other):
        process.fetch()
    other.send("again")
    network.advance_to(network.now + 1)
    assert sum(one.heard.values()) == sent + 1


def test_a_sender_that_is_killed_goes_on_under_strict_replay_and_its_past_is_refused() -> None:
    network, disk = MemoryNetwork(), MemoryNonces()
    reader = Process(network, 2)
    reader.envelope.want("t-1")
    reader.fetch()
    recorder = network.endpoint()
    recorded: list[bytes] = []
    recorder.attach(lambda datagram, _: recorded.append(datagram))
    texts: list[str] = []
    for life in range(4):
        sender = Process(network, 1, nonces=disk)
        sender.fetch()
        for number in range(5):
            texts.append(f"{life}/{number}")
            sender.send(texts[-1])
            network.advance_to(network.now + 0.01)
        sender.endpoint.detach()
    assert list(reader.heard) == [data(text) for text in texts]
    assert reader.refused == {}
    for datagram in recorded:
        recorder.send(datagram)
    network.advance_to(network.now + 1)
    assert set(reader.heard.values()) == {1}
    assert reader.refused == {Drop.REPLAYED: len(texts)}


def test_a_sender_without_its_disk_is_refused_until_there_is_a_new_token() -> None:
    network = MemoryNetwork()
    reader = Process(network, 2)
    reader.envelope.want("t-1")
    reader.fetch()
    before, after = Process(network, 1), Process(network, 1)
    for sender in (before, after):
        sender.fetch()
        for number in range(5):
            sender.send(f"{number}")
        network.advance_to(network.now + 0.1)
    assert (sum(reader.heard.values()), reader.refused) == (5, {Drop.REPLAYED: 5})
    network.advance_to(LIFETIME)
    after.send("under the next key")
    network.advance_to(network.now + 0.1)
    assert reader.heard[data("under the next key")] == 1


def test_a_reader_that_is_killed_takes_the_first_message_it_hears() -> None:
    network = MemoryNetwork()
    sender = Process(network, 1)
    sender.fetch()
    for number in range(100):
        sender.send(f"{number}")
    network.advance_to(1.0)
    reader = Process(network, 2)
    reader.envelope.want("t-1")
    reader.fetch()
    sender.send("news")
    network.advance_to(2.0)
    assert reader.heard == {data("news"): 1}
    assert reader.refused == {}


def test_a_service_that_begins_anew_is_followed() -> None:
    """Other keys under other tokens, or even under the same ones: readers ask when they hear an unknown token."""
    network = MemoryNetwork()
    sender, reader = Process(network, 1), Process(network, 2)
    reader.envelope.want("t-1")
    for process in (sender, reader):
        process.fetch()
    fresh = GroupKeys(SecurityPolicy.AES256_CTR, 900, (key_data(900, "fresh"),), 5.0, LIFETIME)
    sender.envelope.install("t-1", fresh, sender.now)
    sender.send("first")
    network.advance_to(0.5)
    assert reader.refused == {Drop.UNKNOWN_TOKEN: 1}
    assert reader.envelope.keys_wanted(reader.now) == ["t-1"]
    reader.envelope.install("t-1", fresh, reader.now)
    sender.send("second")
    network.advance_to(1.0)
    assert reader.heard == {data("second"): 1}


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32), loss=st.sampled_from([0.0, 0.2]), duplicate=st.sampled_from([0.0, 0.5]))
def test_large_messages_over_a_bad_network_arrive_whole_once_or_are_counted(
    seed: int, loss: float, duplicate: float
) -> None:
    network = MemoryNetwork(seed, max_delay_s=0.5)
    sender, reader = Process(network, 1, max_datagram_bytes=1400), Process(network, 2)
    reader.envelope.want("t-1")
    for process in (sender, reader):
        process.fetch()
    sender.send("first")
    network.advance_to(1.0)
    network.loss, network.duplicate = loss, duplicate
    texts = [f"{number}" * 5_000 for number in range(20)]
    sent: list[list[bytes]] = []
    for text in texts:
        sent.append(sender.send(text))
        network.advance_to(network.now + 0.05)
    network.advance_to(network.now + 5.0)
    reader.envelope.poll(reader.now)
    whole = sum(reader.heard[data(text)] for text in texts)
    heard_of = sum(not reader.arrived.isdisjoint(chunks) for chunks in sent)
    assert max(reader.heard.values()) == 1
    assert whole + reader.counters.drops[Drop.CHUNK_LOST] == heard_of
    assert whole == len(texts) or loss
    assert reader.refused.keys() <= ({Drop.REPLAYED} if duplicate else set())
