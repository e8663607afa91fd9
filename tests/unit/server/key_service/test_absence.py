"""A key service that was away, and processes that went on without it: nobody publishes what the others cannot read."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping

from hypothesis import example, given
from hypothesis import strategies as st

from ua_fleet.pubsub.security.keyring import LIFETIMES_BEYOND, Keyring
from ua_fleet.server.key_service.store import GroupSettings, GroupState, KeyStore
from ua_fleet.wire.security import SecurityPolicy

LIFETIME = 40
"""In steps of the simulation, which are seconds."""
RETRY = LIFETIME // 4
"""The longest that a process waits before it asks again."""
BEGIN = 10 * LIFETIME
"""Everybody has changed keys many times before the service goes."""
SETTINGS = GroupSettings(SecurityPolicy.AES256_CTR, float(LIFETIME), max_future_keys=4, max_past_keys=1)


def numbered() -> Callable[[int], bytes]:
    numbers = itertools.count(1)
    return lambda size: next(numbers).to_bytes(size, "big")


class Fleet:
    """Processes that publish to each other in one group, and their key service, which can be away."""

    def __init__(self, *late_s: int) -> None:
        """Make it; each process asks so many seconds after half of a KeyLifetime is over."""
        self.late_s = late_s
        self.rings = [Keyring("t-2") for _ in late_s]
        self.disk: Mapping[str, GroupState] = {}
        self.token_bytes = numbered()
        self.now = 0
        self.unread: list[tuple[int, int]] = []
        """When which process could not read what another one published, or one published nothing."""
        self.store = self.start()
        for ring in self.rings:
            self.fetch(ring)

    def start(self) -> KeyStore:
        return KeyStore({"t-2": SETTINGS}, self.disk, now=float(self.now), token_bytes=self.token_bytes, save=self.save)

    def save(self, groups: Mapping[str, GroupState]) -> None:
        self.disk = dict(groups)

    def fetch(self, ring: Keyring) -> None:
        ring.install(self.store.get_keys("t-2", 0, 1 + SETTINGS.max_future_keys, float(self.now)), self.now)

    def run(self, seconds: int) -> None:
        """Let time pass; everybody asks as often as he does."""
        for _ in range(seconds):
            for ring, late_s in zip(self.rings, self.late_s, strict=True):
                if ring.is_wanted(self.now - late_s) or ring.sending(self.now) is None:
                    self.fetch(ring)
            self.publish()

    def be_away(self, seconds: int, delays_s: tuple[int, ...]) -> None:
        """The service ends, is started again, and is asked by each process after its delay."""
        for _ in range(seconds):
            self.publish()
        self.store = self.start()
        for second in range(1 + RETRY):
            for ring, delay_s in zip(self.rings, delays_s, strict=True):
                if second == delay_s:
                    self.fetch(ring)
            self.publish()
        self.run(4 * LIFETIME)

    def publish(self) -> None:
        """One second of messages from everybody to everybody."""
        for sender in self.rings:
            token = sender.sending(self.now)
            for number, reader in enumerate(self.rings):
                reader.advance(self.now)
                if token is None or token.token_id not in reader.tokens:
                    self.unread.append((self.now, number))
        self.now += 1


@given(
    late_s=st.tuples(*[st.integers(0, 3)] * 3),
    gone_at=st.integers(0, LIFETIME - 1),
    away=st.integers(0, SETTINGS.max_future_keys * LIFETIME - LIFETIME // 2 - 3 - RETRY),  # until the last has asked
    delays=st.tuples(*[st.integers(0, RETRY)] * 3),
)
@example(late_s=(0, 0, 1), gone_at=20, away=3 * LIFETIME + LIFETIME // 2 - 3 - RETRY, delays=(0, RETRY, RETRY))
def test_nothing_is_lost_while_keys_last_that_everybody_has(
    late_s: tuple[int, int, int], gone_at: int, away: int, delays: tuple[int, int, int]
) -> None:
    fleet = Fleet(*late_s)
    fleet.run(BEGIN + gone_at)
    fleet.be_away(away, delays)
    assert fleet.unread == []


@given(
    gone_at=st.integers(LIFETIME * 3 // 4, LIFETIME - 1),
    away=st.integers(0, (SETTINGS.max_future_keys + LIFETIMES_BEYOND) * LIFETIME - LIFETIME // 2),
    delays=st.tuples(*[st.integers(0, RETRY)] * 3),
)
@example(gone_at=LIFETIME - 1, away=5 * LIFETIME, delays=(0, RETRY, RETRY))
def test_nothing_is_lost_until_two_lifetimes_beyond_the_end_of_a_last_key_that_everybody_has(
    gone_at: int, away: int, delays: tuple[int, int, int]
) -> None:
    fleet = Fleet(0, 0, 0)
    fleet.run(BEGIN + gone_at)
    assert len({tuple(ring.tokens) for ring in fleet.rings}) == 1
    fleet.be_away(away, delays)
    assert fleet.unread == []
