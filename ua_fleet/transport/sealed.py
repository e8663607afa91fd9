"""How a process sends: each message is secured, handed to the transport, and told."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.transport.base import Address, Sends
from ua_fleet.transport.party import Brokered

__all__ = ["SealedSender", "Sent", "Watched"]

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
        self._send_part = transport.send_part if isinstance(transport, Brokered) else self._send_datagram
        self.watched: Watched | None = None
        """Told of each message that is sent; for who looks at messages."""

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send a plain message to all, or to one address alone; without a key it is dropped and counted."""
        for part in self._sealed(datagram, address):
            self._send_part(part, datagram, address)

    def _sealed(self, datagram: bytes, address: Address | None) -> list[bytes]:
        """A message as it goes on the wire, which is told."""
        sealed = self._envelope.seal(datagram, self._clock())
        if sealed and self._sent is not None:
            self._sent(datagram, sum(map(len, sealed)))
        if sealed and self.watched is not None:
            self.watched(datagram, sealed, address)
        return sealed

    def _send_datagram(self, part: bytes, _plain: bytes, address: Address | None) -> None:
        self._transport.send(part, address)

    def send_all(self, datagrams: Iterable[bytes]) -> None:
        """Send plain messages to all."""
        for datagram in datagrams:
            self.send(datagram)
