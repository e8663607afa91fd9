"""The clock that nobody waits for, and the network: what is due next is done next, at its own time.

Processes are asked when something is due for them, and kept in a heap by that time. Nothing scans all of them.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from ua_fleet.topics import SERVER_SPACE
from ua_fleet.transport.base import Address
from ua_fleet.transport.memory import MemoryEndpoint, MemoryNetwork
from ua_fleet.wire import read_security
from ua_fleet.wire.header import MESSAGE_TYPE_BITS, MessageType

__all__ = ["LATENCY_S", "Process", "Route", "World"]

LATENCY_S: Final = 0.001
"""Every datagram is on its way for so long."""
SHORTEST_WAIT_S: Final = 0.001
"""A process is not asked more often."""
_PROBE: Final = MessageType.PROBE << 2


class Process(Protocol):
    """What lives in a world."""

    def receive(self, datagram: bytes, sender: Address) -> None:
        """Take a datagram."""
        ...

    def poll(self) -> None:
        """Do what is due."""
        ...

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        ...


class Route:
    """Who could use a datagram: whoever else got it would verify and decode it, and drop it by his rules.

    What bridges say is for the server: a SkillStatus and a bridge's own status have no form in another robot's space.
    A request is for the bridge that it names, and so is a probe, which may be for all as well; what a bridge announces
    is for the server, and for bridges that have asked it. Responses are sent to one address anyway.
    """

    def __init__(self) -> None:
        self.server: Address = ("", 0)
        self.bridges: dict[int | str | None, Address] = {}
        """By their spaces."""
        self._asking: dict[int | str | None, set[Address]] = {}
        """The bridges that have sent a probe to another one, by its space."""

    def __call__(self, datagram: bytes, sender: Address) -> Iterable[Address] | None:
        """The addresses of the members that could use it; None for all."""
        heard = read_security(datagram)
        if heard.is_discovery and datagram[2] & MESSAGE_TYPE_BITS == _PROBE:
            to = self.server if heard.publisher_id == SERVER_SPACE else self.bridges.get(heard.publisher_id)
            if sender != self.server:
                self._asking.setdefault(heard.publisher_id, set()).add(sender)
            return None if to is None else (to,)
        if sender != self.server:
            bridge = self.bridges.get(heard.publisher_id)
            if heard.is_action and bridge is not None and bridge != sender:
                return (bridge,)
            return (
                (self.server, *sorted(self._asking.get(heard.publisher_id, ())))
                if heard.is_discovery
                else (self.server,)
            )
        if not heard.is_action:
            return ()
        bridge = self.bridges.get(heard.publisher_id)
        return () if bridge is None else (bridge,)


class World:
    """A clock, a network and processes."""

    def __init__(self, seed: int, route: Route | None) -> None:
        """Make a world without processes; a route of None delivers everything to everybody."""
        self._network = MemoryNetwork(seed, min_delay_s=LATENCY_S, max_delay_s=LATENCY_S, route=route)
        self._processes: list[Process] = []
        self._armed: list[float | None] = []
        """When each of them is asked next."""
        self._due: list[tuple[float, int]] = []

    def clock(self) -> float:
        """Seconds since the beginning."""
        return self._network.now

    def endpoint(self) -> MemoryEndpoint:
        """A way into the network for a process that is yet to be made."""
        return self._network.endpoint()

    def add(self, process: Process, endpoint: MemoryEndpoint) -> None:
        """Let a process live here from now on."""
        number = len(self._processes)
        self._processes.append(process)
        self._armed.append(None)
        receive = process.receive

        def deliver(datagram: bytes, sender: Address) -> None:
            receive(datagram, sender)
            self._arm(number)

        endpoint.attach(deliver)
        self._arm(number)

    def run(self, is_over: Callable[[], bool], limit_s: float) -> bool:
        """Let time pass until it is over; False where that is not so after `limit_s`."""
        network, due = self._network, self._due
        while not is_over():
            delivery = network.next_delivery()
            while due and self._armed[due[0][1]] != due[0][0]:
                heapq.heappop(due)
            at = min((time for time in (delivery, due[0][0] if due else None) if time is not None), default=limit_s)
            if at >= limit_s:
                return False
            if at == delivery:
                network.step()
                continue
            network.advance_to(at)
            _, number = heapq.heappop(due)
            self._armed[number] = None
            self._processes[number].poll()
            self._arm(number, not_before=at + SHORTEST_WAIT_S)
        return True

    def _arm(self, number: int, not_before: float = 0.0) -> None:
        deadline = self._processes[number].next_deadline()
        if deadline is None:
            return
        deadline = max(deadline, not_before, self._network.now)
        armed = self._armed[number]
        if armed is None or deadline < armed:
            self._armed[number] = deadline
            heapq.heappush(self._due, (deadline, number))
