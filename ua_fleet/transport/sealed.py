"""How a process sends: each message is secured, handed to the transport, and told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from typing import Final

from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.transport.base import Address, Sends, TransportStats
from ua_fleet.transport.party import Brokered

__all__ = ["SealedSender", "Sent", "Watched", "data_group"]

_HEAD: Final = b"\xf1\x01"
"""How a message of ours with data begins: PublisherId (UInt16), GroupHeader, PayloadHeader."""
_GROUP_FLAGS_AT: Final = 4
_GROUP_AT: Final = slice(5, 7)


def data_group(datagram: bytes) -> int | None:
    """The WriterGroupId of a plain message of ours with data; None for any other message."""
    if datagram[:2] != _HEAD or len(datagram) < _GROUP_AT.stop or datagram[_GROUP_FLAGS_AT] != 1:
        return None
    return int.from_bytes(datagram[_GROUP_AT], "little")


Sent = Callable[[bytes, int], None]
"""Told of each message that is sent: as it was before it was secured, and its bytes on the wire."""

Watched = Callable[[bytes, list[bytes], Address | None], None]
"""Told of each message that is sent: as it was before it was secured, the datagrams, and the address if it is one."""


class SealedSender:
    """See the module."""

    def __init__(
        self, envelope: Envelope, transport: Sends, clock: Callable[[], float], sent: Sent | None = None
    ) -> None:
        """`clock` is in seconds, and `sent` is told of each message."""
        self._envelope, self._transport, self._clock, self._sent = envelope, transport, clock, sent
        self._send_part = transport.send_part if isinstance(transport, Brokered) else None
        """Of a transport over a broker, in place of its `send`."""
        self.watched: Watched | None = None
        """Told of each message that is sent; for who looks at messages."""
        stats = getattr(transport, "stats", None)
        self._stats = stats if isinstance(stats, TransportStats) else TransportStats()
        self._seen_failed = self._stats.send_failed
        self.failed = Counter[int]()
        """NetworkMessages with data that could not be sent, by WriterGroupId."""
        self.not_secured = Counter[int]()
        """Those that could not be signed or encrypted, by WriterGroupId."""

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send a plain message to all, or to one address alone; without a key it is dropped and counted."""
        for part in self._sealed(datagram, address):
            if self._send_part is None:
                self._transport.send(part, address)
            else:
                self._send_part(part, datagram, address)
        if self._stats.send_failed != self._seen_failed:
            self._count_failed(datagram)

    def _count_failed(self, datagram: bytes) -> None:
        """The transport has not taken datagrams of this plain message."""
        failed, self._seen_failed = self._stats.send_failed - self._seen_failed, self._stats.send_failed
        if (group := data_group(datagram)) is not None:
            self.failed[group] += failed

    def oldest_s(self) -> float:
        """How long ago the message came that waits longest: nothing waits here."""
        return 0.0

    def close(self) -> None:
        """Send nothing more of what waits."""

    def _sealed(self, datagram: bytes, address: Address | None) -> list[bytes]:
        """A message as it goes on the wire, which is told."""
        sealed = self._envelope.seal(datagram, self._clock())
        if not sealed and (group := data_group(datagram)) is not None:
            self.not_secured[group] += 1
        if sealed and self._sent is not None:
            self._sent(datagram, sum(map(len, sealed)))
        if sealed and self.watched is not None:
            self.watched(datagram, sealed, address)
        return sealed

    def send_all(self, datagrams: Iterable[bytes]) -> None:
        """Send plain messages to all."""
        for datagram in datagrams:
            self.send(datagram)
