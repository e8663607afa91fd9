"""A network in memory that loses, delays, duplicates and so reorders, the same way for the same seed.

The clock is virtual: nothing moves until the owner moves it.

    network = MemoryNetwork(seed=7, loss=0.1, duplicate=0.1, max_delay_s=0.05)
    one, other = network.endpoint(), network.endpoint()
    one.attach(receive_one); other.attach(receive_other)
    one.send(b"...")
    network.advance_to(1.0)          # delivers to both: a sender hears its own multicast

A network of many members may be told who could use a datagram (`route`), so that it
need not carry each to everybody.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from itertools import count
from random import Random
from typing import Final

from ua_fleet.transport.base import Address, Receive, TransportStats

__all__ = ["MemoryEndpoint", "MemoryNetwork", "Route"]

Route = Callable[[bytes, Address], Iterable[Address] | None]
"""The members that could use a datagram of a sender; None: all of them."""

_FIRST_PORT: Final = 49_152


class MemoryNetwork:
    """One multicast group in memory. `loss`, `duplicate` and the delays may be changed at any time."""

    def __init__(
        self,
        seed: int = 0,
        *,
        loss: float = 0.0,
        duplicate: float = 0.0,
        min_delay_s: float = 0.0,
        max_delay_s: float = 0.0,
        now: float = 0.0,
        route: Route | None = None,
    ) -> None:
        """Make a network without members.

        Args:
            seed: decides what is lost, duplicated and how long it takes.
            loss: probability that a receiver does not get a datagram; each receiver has its own luck.
            duplicate: probability that a receiver gets it twice.
            min_delay_s: the shortest way.
            max_delay_s: the longest way; different delays reorder.
            now: the clock's first time.
            route: who gets what is sent to all; without, everybody does.
        """
        self.now = now
        self.loss = loss
        self.duplicate = duplicate
        self.min_delay_s = min_delay_s
        self.max_delay_s = max_delay_s
        self._random = Random(seed)  # noqa: S311 - luck that can be repeated
        self._route = route
        self._endpoints: dict[Address, MemoryEndpoint] = {}
        self._way: list[tuple[float, int, MemoryEndpoint, bytes, Address]] = []
        self._order = count()

    def endpoint(self) -> MemoryEndpoint:
        """A new member of the group. It gets what is sent from now on, once it is attached or started."""
        endpoint = MemoryEndpoint(self, ("127.0.0.1", _FIRST_PORT + len(self._endpoints)))
        self._endpoints[endpoint.address] = endpoint
        return endpoint

    def next_delivery(self) -> float | None:
        """When the next datagram arrives, or None."""
        return self._way[0][0] if self._way else None

    def step(self) -> bool:
        """Deliver the next datagram at its time; False if none is on its way."""
        if not self._way:
            return False
        due, _, endpoint, datagram, sender = heapq.heappop(self._way)
        if due > self.now:
            self.now = due
        endpoint.deliver(datagram, sender)
        return True

    def advance_to(self, now: float) -> None:
        """Deliver all that arrives until `now`, answers to it included, and set the clock."""
        while self._way and self._way[0][0] <= now:
            self.step()
        self.now = max(self.now, now)

    def carry(self, datagram: bytes, sender: MemoryEndpoint, address: Address | None = None) -> None:
        """Put a datagram on its way to all members, or to the one with this address."""
        random, own = self._random.random, sender.address
        shortest_s, spread_s = self.min_delay_s, self.max_delay_s - self.min_delay_s
        for endpoint in self._receivers(datagram, own, address):
            if random() < self.loss:
                continue
            for _ in range(2 if random() < self.duplicate else 1):
                due = self.now + (shortest_s + spread_s * random())
                heapq.heappush(self._way, (due, next(self._order), endpoint, datagram, own))

    def _receivers(self, datagram: bytes, sender: Address, address: Address | None) -> Iterable[MemoryEndpoint]:
        if address is None:
            addresses = None if self._route is None else self._route(datagram, sender)
            if addresses is None:
                return self._endpoints.values()
        else:
            addresses = (address,)
        return [self._endpoints[one] for one in addresses if one in self._endpoints]


class MemoryEndpoint:
    """A member of a MemoryNetwork; a Transport."""

    def __init__(self, network: MemoryNetwork, address: Address) -> None:
        self.address = address
        self.stats = TransportStats()
        self.reachable = True
        """False cuts this member off in both directions."""
        self._network = network
        self._receive: Receive | None = None

    def is_own(self, sender: Address) -> bool:
        """See KnowsItself."""
        return sender == self.address

    def attach(self, receive: Receive) -> None:
        """Hand each datagram to `receive` from now on: `start` without an event loop."""
        self._receive = receive

    def detach(self) -> None:
        """Receive nothing more: `close` without an event loop."""
        self._receive = None

    async def start(self, receive: Receive) -> None:
        """Hand each datagram to `receive` from now on."""
        self.attach(receive)

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send to all members, ourselves included, or to one. It arrives when the network's clock is moved."""
        if not self.reachable:
            self.stats.send_failed += 1
            return
        self.stats.sent += 1
        self._network.carry(datagram, self, address)

    def deliver(self, datagram: bytes, sender: Address) -> None:
        """Called by the network when a datagram arrives here."""
        if self._receive is not None and self.reachable:
            self.stats.received += 1
            self._receive(datagram, sender)

    async def close(self) -> None:
        """Receive nothing more. Safe to call twice."""
        self.detach()
