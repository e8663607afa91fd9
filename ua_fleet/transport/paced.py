"""How a process with large messages sends: small ones at once, large ones chunk by chunk at a pace.

    small message            now, unless a large one of its DataSetWriter waits: then behind it
    large message            at the end of the queue, [secured and] split as its turn comes

A burst of two megabytes overruns the receive buffer of whoever is busy for a moment, and keeps an answer to a command
waiting. So what is large goes a few chunks at a time, and everything small goes between. The messages of one
DataSetWriter stay in their order. Where a newer large message of a writer comes before the one that waits has begun,
the older one goes, counted as `too_old`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from typing import Final, Protocol

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.rate import Budget
from ua_fleet.transport.base import Address, Sends
from ua_fleet.transport.sealed import SealedSender, Sent
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.outline import read_outline

__all__ = ["BURST_BYTES", "BYTES_PER_SECOND", "PacedSender"]

BYTES_PER_SECOND: Final = 100_000_000
BURST_BYTES: Final = 256 * 1024
"""At once; fits the receive buffer of a stock Linux (twice 212,992 bytes with what the kernel adds)."""
MOST_QUEUED_BYTES: Final = 64 * 1024 * 1024


class Timer(Protocol):
    """What `call_at` gives."""

    def cancel(self) -> None:
        """Do not call."""
        ...


CallAt = Callable[[float, Callable[[], None]], Timer]
_Writer = tuple[int | None, int]
"""WriterGroupId and DataSetWriterId; all is of one PublisherId."""


class _Waiting:
    """A message that waits, or is on its way."""

    __slots__ = ("address", "arrived", "datagram", "is_large", "parts", "size", "writers")

    def __init__(
        self, datagram: bytes, address: Address | None, writers: frozenset[_Writer], *, is_large: bool, arrived: float
    ) -> None:
        self.datagram, self.address, self.writers, self.is_large = datagram, address, writers, is_large
        self.arrived = arrived
        self.parts: Iterator[bytes] | None = None
        """The rest of it, once it has begun."""
        self.size = 0
        """Bytes on the wire so far."""


class PacedSender(SealedSender):
    """See the module. All of it runs in the event loop."""

    def __init__(
        self,
        envelope: Envelope,
        transport: Sends,
        clock: Callable[[], float],
        call_at: CallAt,
        counters: Counters,
        sent: Sent | None = None,
        *,
        arrived: Callable[[], float | None] = lambda: None,
        gone: Callable[[float, float], None] = lambda _lag_s, _now: None,
    ) -> None:
        """Make a sender with nothing to send.

        Args:
            envelope: secures and splits.
            transport: takes the datagrams.
            clock: seconds.
            call_at: of an event loop with that clock.
            counters: what newer messages push out is counted here.
            sent: told of each message that is sent.
            arrived: when what is being sent had come, where it came from the robot side.
            gone: told of each large message how long after that its last chunk was sent, and the time.
        """
        super().__init__(envelope, transport, clock, sent)
        self._call_at, self._counters, self._arrived, self._gone = call_at, counters, arrived, gone
        self._queue: deque[_Waiting] = deque()
        self._queued_bytes = 0
        self._budget = Budget(BYTES_PER_SECOND, BURST_BYTES)
        self._timer: Timer | None = None

    def send(self, datagram: bytes, address: Address | None = None) -> None:
        """Send a plain message, to all or to one address alone; what is large may go a little later."""
        is_large = len(datagram) > self._envelope.max_plain_bytes
        if not is_large and not self._queue:
            for part in self._sealed(datagram, address):
                if self._send_part is None:
                    self._transport.send(part, address)
                else:
                    self._send_part(part, datagram, address)
            if self._stats.send_failed != self._seen_failed:
                self._count_failed(datagram)
            return
        writers = _writers_of(datagram)
        if not writers or not (is_large or self._follows(writers)):
            super().send(datagram, address)
            return
        if is_large:
            self._push_out(writers, len(datagram))
        since = self._arrived()
        now = self._clock()
        self._queue.append(
            _Waiting(datagram, address, writers, is_large=is_large, arrived=now if since is None else since)
        )
        self._queued_bytes += len(datagram)
        if self._timer is None:
            self._pump()

    def oldest_s(self) -> float:
        """How long ago the message came that waits longest; 0 where none does."""
        return max(self._clock() - self._queue[0].arrived, 0.0) if self._queue else 0.0

    def close(self) -> None:
        """Send nothing more of what waits."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._queue.clear()
        self._queued_bytes = 0

    def _follows(self, writers: frozenset[_Writer]) -> bool:
        return any(not writers.isdisjoint(waiting.writers) for waiting in self._queue)

    def _push_out(self, writers: frozenset[_Writer], size: int) -> None:
        """Let what has not begun go for a newer message of its writer, and the oldest where there is too much."""
        kept: deque[_Waiting] = deque()
        for waiting in self._queue:
            if waiting.parts is None and waiting.is_large and waiting.writers == writers:
                self._drop(waiting)
            else:
                kept.append(waiting)
        while kept and self._queued_bytes + size > MOST_QUEUED_BYTES and kept[-1].parts is None:
            first = next(waiting for waiting in kept if waiting.parts is None)
            kept.remove(first)
            self._drop(first)
        self._queue = kept

    def _drop(self, waiting: _Waiting) -> None:
        self._queued_bytes -= len(waiting.datagram)
        self._counters.drop(Drop.TOO_OLD)

    def _pump(self) -> None:
        """Send as much as the pace allows, and come again for the rest."""
        self._timer = None
        now = self._clock()
        while self._queue and self._budget.left(now) > 0:
            waiting = self._queue[0]
            if waiting.parts is None:
                waiting.parts = self._envelope.parts(waiting.datagram, self._clock)
            try:
                part = next(waiting.parts, None)
            except LocalWireError:
                self._counters.drop(Drop.CONVERSION)
                continue  # it ends there: the next part is none
            if part is not None:
                if self._send_part is None:
                    self._transport.send(part, waiting.address)
                else:
                    self._send_part(part, waiting.datagram, waiting.address)
                if self._stats.send_failed != self._seen_failed:
                    self._count_failed(waiting.datagram)
                waiting.size += len(part)
                self._budget.spend(now, len(part))
                continue
            self._queue.popleft()
            self._queued_bytes -= len(waiting.datagram)
            if waiting.size and self._sent is not None:
                self._sent(waiting.datagram, waiting.size)
            if waiting.is_large:
                gone_at = self._clock()
                self._gone(gone_at - waiting.arrived, gone_at)
        if self._queue:
            self._timer = self._call_at(self._budget.at(BURST_BYTES / 2), self._pump)


def _writers_of(datagram: bytes) -> frozenset[_Writer]:
    """The writers of a data message; none for Actions and discovery messages, which wait for nothing."""
    try:
        outline = read_outline(Cursor(datagram))
    except RemoteWireError:
        return frozenset()
    if outline.is_action or outline.is_discovery:
        return frozenset()
    return frozenset([(outline.writer_group_id, writer) for writer in outline.writer_ids])
