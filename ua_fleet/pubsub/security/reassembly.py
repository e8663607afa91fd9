"""Messages put together from chunks that come in any order, within bounds (OPC 10000-14 7.2.4.4.4).

A message stands here from its first chunk until its last one, or until `CHUNK_TIMEOUT_S` are over. Each sender has a
budget: what does not fit into it goes, the sender's message that holds most first, and the older of equals. Of more
senders than there is room for, the one that holds most loses his own. So who sends chunks without end takes nobody
else's place. A sender is a PublisherId, with its Actions apart from its data; who may say that he is it, the keys of
message security decide. Chunks of one message must not overlap, and must agree on its size. Their
headers may differ, since each is a NetworkMessage with numbers and a Timestamp of its own. A duplicate is ignored, also
of a message that was completed or given up a moment ago.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from typing import Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.chunks import Chunk, join

__all__ = ["CHUNK_TIMEOUT_S", "MOST_MESSAGES", "Reassembly"]

CHUNK_TIMEOUT_S: Final = 2.0
"""A message whose chunks have not all come after so long is given up."""
MOST_MESSAGES: Final = 128
"""Unfinished messages of a sender."""
FULL_SENDERS: Final = 8
"""So many senders may use the whole of their budget at the same time."""
MOST_ENDED: Final = 512
"""Messages that were completed or given up, and whose late chunks are still known as such."""
LEAST_CHUNK_BYTES: Final = 256
"""A chunk counts as at least so much, whatever it carries: so their number is bounded too."""

_Key = tuple[int | str | None, int, int | None, int | None, bool, bool, int, int]
_Sender = tuple[int | str | None, int, bool]


class _Unfinished:
    """The chunks of one message that have come."""

    __slots__ = ("data", "first", "held", "offsets", "received", "since")

    def __init__(self, first: Chunk, now: float) -> None:
        self.first = first
        self.since = now
        self.offsets: list[int] = []
        """Of the chunks, ascending."""
        self.data: list[bytes | memoryview] = []
        self.received = 0
        self.held = 0

    def add(self, chunk: Chunk) -> bool:
        """Take a chunk in; False for a duplicate. Raises RemoteWireError where it contradicts what has come."""
        first, offset, data = self.first, chunk.offset, chunk.data
        if chunk.total_size != first.total_size:
            detail = f"offset {offset}: {chunk.total_size} bytes in all, {first.total_size} before"
            raise RemoteWireError(Cause.CHUNK_CONTRADICTS, detail)
        at = bisect_left(self.offsets, offset)
        if at < len(self.offsets):
            following = self.offsets[at]
            if following == offset and self.data[at] == data:
                return False
            if offset + len(data) > following:
                raise RemoteWireError(Cause.CHUNK_OVERLAPS, f"bytes {offset} to {offset + len(data)} have come before")
        if at and self.offsets[at - 1] + len(self.data[at - 1]) > offset:
            raise RemoteWireError(Cause.CHUNK_OVERLAPS, f"bytes from {offset} on have come before")
        self.offsets.insert(at, offset)
        self.data.insert(at, data)
        self.received += len(data)
        self.held += max(len(data), LEAST_CHUNK_BYTES)
        return True


class Reassembly:
    """All unfinished messages of one process."""

    def __init__(self, counters: Counters, max_bytes: int) -> None:
        """Make it empty.

        Args:
            counters: messages that are given up are counted here.
            max_bytes: the largest message, and about what all unfinished ones of a sender together may hold.
        """
        self._counters = counters
        self._max_bytes = max_bytes
        self._unfinished: dict[_Key, _Unfinished] = {}
        """The oldest first."""
        self._ended: dict[_Key, float] = {}
        self._senders: dict[_Sender, dict[_Key, _Unfinished]] = {}
        """The same by their senders."""
        self._held_by: Counter[_Sender] = Counter()
        self._held = 0

    @property
    def held_bytes(self) -> int:
        """What the chunks of all unfinished messages count as."""
        return self._held

    def add(self, chunk: Chunk, now: float) -> bytes | None:
        """Take a chunk; the whole plain message when it was the last one missing.

        Raises:
            RemoteWireError: it contradicts what has come, and the message is given up; or the message is too large.
        """
        self.poll(now)
        if chunk.total_size > self._max_bytes:
            detail = f"a message of {chunk.total_size} bytes; pubsub.max_message_bytes is {self._max_bytes}"
            raise RemoteWireError(Cause.CHUNK_TOO_LARGE, detail)
        key = (*chunk[:6], chunk.message_sequence_number, hash(chunk.action_header))
        if key in self._ended:
            return None
        unfinished = self._unfinished.get(key)
        sender = _sender_of(key)
        if unfinished is None:
            if len(self._senders.get(sender, ())) >= MOST_MESSAGES:
                self._give_up(self._largest(sender), now)
            elif len(self._unfinished) >= FULL_SENDERS * MOST_MESSAGES:
                self._give_up(self._largest(self._greediest()), now)
            unfinished = self._unfinished[key] = _Unfinished(chunk, now)
            self._senders.setdefault(sender, {})[key] = unfinished
        held = unfinished.held
        try:
            unfinished.add(chunk)
        except RemoteWireError:
            self._give_up(key, now)
            raise
        self._held += unfinished.held - held
        self._held_by[sender] += unfinished.held - held
        if unfinished.received == chunk.total_size:
            self._end(key, now)
            return join(chunk, *unfinished.data)
        most = self._max_bytes + LEAST_CHUNK_BYTES  # the last chunk of one may be a small one
        while self._held_by[sender] > most:
            self._give_up(self._largest(sender), now)
        while self._held > FULL_SENDERS * most:
            self._give_up(self._largest(self._greediest()), now)
        return None

    def poll(self, now: float) -> None:
        """Give up what has taken too long."""
        unfinished = self._unfinished
        while unfinished:
            key, oldest = next(iter(unfinished.items()))
            if oldest.since + CHUNK_TIMEOUT_S > now:
                break
            self._give_up(key, now)
        ended = self._ended
        while ended:
            key, at = next(iter(ended.items()))
            if at + CHUNK_TIMEOUT_S > now and len(ended) <= MOST_ENDED:
                break
            del ended[key]

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        for oldest in self._unfinished.values():
            return oldest.since + CHUNK_TIMEOUT_S
        return None

    def _greediest(self) -> _Sender:
        return max(self._senders, key=self._held_by.__getitem__)

    def _largest(self, sender: _Sender) -> _Key:
        messages = self._senders[sender]
        return max(messages, key=lambda key: messages[key].held)  # the oldest of equals

    def _give_up(self, key: _Key, now: float) -> None:
        self._counters.drop(Drop.CHUNK_LOST)
        self._end(key, now)

    def _end(self, key: _Key, now: float) -> None:
        held, sender = self._unfinished.pop(key).held, _sender_of(key)
        self._held -= held
        self._held_by[sender] -= held
        messages = self._senders[sender]
        del messages[key]
        if not messages:
            del self._senders[sender], self._held_by[sender]
        self._ended[key] = now


def _sender_of(key: _Key) -> _Sender:
    return key[0], key[1], key[4]
