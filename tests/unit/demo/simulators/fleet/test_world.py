"""Time goes from one deadline to the next, and a datagram to who could use it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from ua_demo.simulators.fleet.world import LATENCY_S, Route, World

from ua_fleet.transport.base import Address
from ua_fleet.transport.memory import MemoryEndpoint
from ua_fleet.wire import ActionMessage, ActionState, Codec, encode_action, encode_announcement, encode_probe
from ua_fleet.wire.discovered import StatusAnnouncement
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, Probe, ProbeKind

SERVER: Address = ("127.0.0.1", 1)
ONE: Address = ("127.0.0.1", 2)
OTHER: Address = ("127.0.0.1", 3)
REQUEST = ActionMessage(256, 2, 3, 1, 1, ActionState.EXECUTING, True, "0.server", bytes(16))
DATA = NetworkMessage(256, writer_group_id=2, messages=(DataSetMessage(1, FrameKind.KEEP_ALIVE, sequence_number=1),))


class Ticker:
    """Is asked at some times, and says when it was; answers each datagram once."""

    def __init__(self, times: list[float], clock: Callable[[], float], endpoint: MemoryEndpoint) -> None:
        self._times, self._clock, self._endpoint = times, clock, endpoint
        self.asked: list[float] = []
        self.heard: list[tuple[float, bytes]] = []

    def receive(self, datagram: bytes, sender: Address) -> None:
        self.heard.append((self._clock(), datagram))
        if datagram == b"sooner":
            self._times.insert(0, self._clock() + 0.5)

    def poll(self) -> None:
        self.asked.append(self._clock())
        while self._times and self._times[0] <= self._clock():
            del self._times[0]
        if self._clock() == 1.0:
            self._endpoint.send(b"sooner")

    def next_deadline(self) -> float | None:
        return self._times[0] if self._times else None


class Restless(Ticker):
    """Has something to do at all times."""

    def next_deadline(self) -> float | None:
        return 0.0


def test_processes_are_asked_at_their_times_and_datagrams_take_a_while() -> None:
    world = World(0, None)
    endpoints = [world.endpoint(), world.endpoint()]
    one, other = [
        Ticker(times, world.clock, endpoint)
        for times, endpoint in zip(([1.0, 4.0], [2.0, 10.0]), endpoints, strict=True)
    ]
    for ticker, endpoint in zip((one, other), endpoints, strict=True):
        world.add(ticker, endpoint)
    assert not world.run(lambda: False, 9.0)
    assert one.heard == other.heard == [(1.0 + LATENCY_S, b"sooner")]
    assert one.asked == [1.0, 1.5 + LATENCY_S, 4.0]
    assert other.asked == [1.5 + LATENCY_S, 2.0]
    assert world.run(lambda: len(other.asked) == 3, 11.0)
    assert world.clock() == 10.0


def test_a_process_that_is_always_due_does_not_stop_the_clock() -> None:
    world = World(0, None)
    endpoint = world.endpoint()
    ticker = Restless([], world.clock, endpoint)
    world.add(ticker, endpoint)
    assert not world.run(lambda: False, 0.0055)
    assert len(ticker.asked) == 6


@pytest.mark.parametrize(
    ("datagram", "sender", "receivers"),
    [
        (encode_action(REQUEST), SERVER, [ONE]),
        (encode_action(REQUEST._replace(publisher_id=999)), SERVER, []),
        (encode_action(REQUEST._replace(is_request=False)), ONE, [SERVER]),
        (Codec().encode(DATA), ONE, [SERVER]),
        (Codec().encode(DATA._replace(publisher_id=0)), SERVER, []),
        (encode_announcement(StatusAnnouncement(256, 1, 0, False, 2)), ONE, [SERVER]),
        (encode_announcement(StatusAnnouncement(0, 1, 0, False, 2)), SERVER, []),
        (encode_probe(Probe(257, 1, ProbeKind.DATA_SET_META_DATA, (1,))), ONE, [OTHER]),
        (encode_probe(Probe(0, 1, ProbeKind.ENDPOINTS)), ONE, [SERVER]),
        (encode_probe(Probe(None, 1, ProbeKind.FIND_APPLICATIONS)), ONE, None),
    ],
)
def test_who_could_use_a_datagram(datagram: bytes, sender: Address, receivers: list[Address] | None) -> None:
    route = Route()
    route.server, route.bridges = SERVER, {256: ONE, 257: OTHER}
    found = route(datagram, sender)
    assert (None if found is None else list(found)) == receivers
