"""What every transport offers to the processes above it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from ua_fleet.counters import Counters, Drop

__all__ = ["Address", "KnowsItself", "Receive", "Sends", "Transport", "TransportStats"]

Address = tuple[str, int]
"""IP address and port of a sender."""

Receive = Callable[[bytes, Address], None]
"""Called in the event loop with each datagram and its sender; must not raise and must not block."""


@dataclass(slots=True)
class TransportStats:
    """Figures of one transport since its start."""

    sent: int = 0
    received: int = 0
    send_failed: int = 0
    """Datagrams that the kernel did not take."""
    kernel_drops: int = 0
    """Datagrams that the kernel dropped before we read them, where it tells."""
    receive_buffer_bytes: int = 0
    """Size of the receive buffer that the kernel gave."""
    drops: Counter[Drop] = field(default_factory=Counter[Drop])
    """What a transport over a broker did not send or hand on, by cause."""
    malformed: Counter[str] = field(default_factory=Counter[str])
    """Messages that it could not decode, by cause: of JSON, which is decoded here."""
    forgiven: Counter[str] = field(default_factory=Counter[str])
    """What JSON messages did wrong and was read all the same, by name."""
    problem: str = ""
    """Why nothing can be sent or received now, where the transport can tell; empty while all is well."""

    def count_drops(self, counters: Counters) -> None:
        """Put what the kernel dropped or did not take, or a broker, into a process's counters."""
        counters.drops[Drop.KERNEL] = self.kernel_drops
        counters.drops[Drop.SEND_FAILED] = self.send_failed
        for cause, count in self.drops.items():
            counters.drop(cause, count)
        self.drops.clear()
        for name, count in self.malformed.items():
            counters.drop_malformed(name, count)
        self.malformed.clear()
        counters.forgiven += self.forgiven
        self.forgiven.clear()


class Sends(Protocol):
    """What sends datagrams to all members of a PubSub connection."""

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send to all members, or to one address alone. Never blocks; what the kernel refuses is counted, not raised.

        The address that members see as the sender of a datagram is one that this transport receives at.
        """
        ...


@runtime_checkable
class KnowsItself(Protocol):
    """A transport that can tell its own messages from those of others."""

    def is_own(self, sender: Address) -> bool:
        """Whether what came from there was sent by this transport."""
        ...


class Transport(Sends, Protocol):
    """A way for datagrams to all members of a PubSub connection, and back to one of them.

    The sender may hear itself, too, and need not.
    """

    stats: TransportStats

    async def start(self, receive: Receive) -> None:
        """Open the transport and hand each datagram to `receive` from now on.

        Raises:
            TransportError: no such interface, no route, no permission, address in use; with the remedy.
        """
        ...

    async def close(self) -> None:
        """Release everything. Safe to call twice."""
        ...
