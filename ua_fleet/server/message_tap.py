"""Shows what the hub sends and receives to `pubsub.recent`, while somebody looks."""

from __future__ import annotations

from collections.abc import Callable

from ua_fleet.counters import Counters
from ua_fleet.pubsub.recent import RecentMessages
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.transport.base import Address
from ua_fleet.transport.connections import Sender

__all__ = ["MessageTap"]


class MessageTap:
    """Stands beside the way of messages, and changes nothing of it."""

    def __init__(
        self,
        recent: RecentMessages,
        subscriber: Subscriber,
        sender: Sender,
        counters: Counters,
        wall_ticks: Callable[[], int],
    ) -> None:
        """Hear of what is sent from now on; what is received comes by `received`."""
        self._recent, self._subscriber, self._counters, self._wall_ticks = recent, subscriber, counters, wall_ticks
        self._plain: bytes | None = None
        sender.watch(self._sent)

    def received(self, datagram: bytes, sender: Address, take: Callable[[bytes, Address], None]) -> None:
        """Have a datagram taken, and keep it with what became of it."""
        before = dict(self._counters.drops)
        self._plain = None
        self._subscriber.opened = self._opened
        try:
            take(datagram, sender)
        finally:
            self._subscriber.opened = None
        dropped = " ".join(cause for cause, count in self._counters.drops.items() if count > before.get(cause, 0))
        self._recent.received(datagram, self._plain, self._wall_ticks(), _text(sender), dropped)

    def _opened(self, plain: bytes) -> None:
        self._plain = plain

    def _sent(self, plain: bytes, datagrams: list[bytes], address: Address | None) -> None:
        if self._recent.is_wanted:
            self._recent.sent(plain, datagrams, self._wall_ticks(), "" if address is None else _text(address))


def _text(address: Address) -> str:
    return f"{address[0]}:{address[1]}"
