"""Large messages go at a pace, small ones between their chunks, and those of one writer in their order."""

from __future__ import annotations

import heapq
from collections.abc import Callable

import pytest

from tests.unit.pubsub.security.securing import data
from ua_fleet.counters import Counters, Drop
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.transport.base import Address
from ua_fleet.transport.paced import BURST_BYTES, BYTES_PER_SECOND, PacedSender
from ua_fleet.wire.security import SecurityMode

SPACE = 2


class Timer:
    is_cancelled = False

    def cancel(self) -> None:
        self.is_cancelled = True


class Wire:
    """Notes what is sent, and has a clock with timers."""

    def __init__(self) -> None:
        self.now = 0.0
        self.sent: list[tuple[float, bytes]] = []
        self.lags: list[float] = []
        self.told: list[int] = []
        self.counters = Counters()
        self._timers: list[tuple[float, int, Timer, Callable[[], None]]] = []
        self.envelope = Envelope(SPACE, self.counters, mode=SecurityMode.NONE, nonces=MemoryNonces())
        self.reader = Envelope(3, Counters(), mode=SecurityMode.NONE, nonces=MemoryNonces())
        self.sender = PacedSender(
            self.envelope,
            self,
            lambda: self.now,
            self.call_at,
            self.counters,
            lambda plain, size: self.told.append(size - len(plain)),
            gone=lambda lag, _now: self.lags.append(lag),
        )

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        self.sent.append((self.now, datagram))

    def call_at(self, when: float, callback: Callable[[], None]) -> Timer:
        timer = Timer()
        heapq.heappush(self._timers, (when, len(self.sent), timer, callback))
        return timer

    def advance_to(self, now: float) -> None:
        while self._timers and self._timers[0][0] <= now:
            when, _, timer, callback = heapq.heappop(self._timers)
            self.now = max(self.now, when)
            if not timer.is_cancelled:
                callback()
        self.now = max(self.now, now)

    def wholes(self) -> list[bytes]:
        """The messages that have arrived."""
        opened = [self.reader.open(datagram, now) for now, datagram in self.sent]
        return [whole for whole in opened if whole is not None]


def large(letter: str, writer: int, size: int = 2_000_000) -> bytes:
    return data(letter * size, publisher_id=SPACE, writer_id=writer)


def small(letter: str, writer: int) -> bytes:
    return data(letter, publisher_id=SPACE, writer_id=writer)


@pytest.fixture
def wire() -> Wire:
    return Wire()


def test_a_large_message_goes_at_a_pace_and_arrives(wire: Wire) -> None:
    plain = large("x", 1)
    wire.sender.send(plain)
    assert sum(len(datagram) for _, datagram in wire.sent) <= BURST_BYTES + 65_507
    wire.advance_to(1.0)
    assert wire.wholes() == [plain]
    took = wire.sent[-1][0]
    assert took == pytest.approx(len(plain) / BYTES_PER_SECOND, abs=0.004)
    assert wire.lags == [pytest.approx(took)]
    for begin in [when for when, _ in wire.sent]:
        within = sum(len(datagram) for when, datagram in wire.sent if begin <= when < begin + 0.001)
        assert within <= BURST_BYTES + BYTES_PER_SECOND * 0.001 + 2 * 65_507
    assert len(wire.told) == 1
    assert wire.sender.oldest_s() == 0.0


def test_small_messages_go_between_and_those_of_the_same_writer_behind(wire: Wire) -> None:
    cloud = large("c", 1)
    wire.sender.send(cloud)
    wire.sender.send(small("a", 1))
    wire.sender.send(small("b", 2))
    assert wire.sent[-1][1] == small("b", 2), "at once"
    wire.advance_to(1.0)
    assert wire.wholes() == [small("b", 2), cloud, small("a", 1)]


def test_large_messages_of_different_writers_take_turns_whole(wire: Wire) -> None:
    messages = [large("a", 1), large("b", 2), large("c", 3)]
    for message in messages:
        wire.sender.send(message)
    wire.advance_to(1.0)
    assert wire.wholes() == messages


def test_a_newer_message_takes_the_place_of_the_one_that_waits(wire: Wire) -> None:
    messages = [large(letter, 1) for letter in "abcd"]
    for message in messages:
        wire.sender.send(message)
    wire.advance_to(0.005)
    assert wire.sender.oldest_s() == pytest.approx(0.005)
    wire.advance_to(1.0)
    assert wire.wholes() == [messages[0], messages[3]]
    assert wire.counters.drops == {Drop.TOO_OLD: 2}


def test_what_waits_is_bounded(wire: Wire) -> None:
    for writer in range(1, 100):
        wire.sender.send(large("x", writer))
    wire.advance_to(10.0)
    arrived = len(wire.wholes())
    assert arrived + wire.counters.drops[Drop.TOO_OLD] == 99
    assert 30 <= arrived <= 35


def test_nothing_is_sent_once_closed(wire: Wire) -> None:
    wire.sender.send(large("x", 1))
    sent = len(wire.sent)
    wire.sender.close()
    wire.advance_to(1.0)
    assert len(wire.sent) == sent
