"""How datagrams come in: our own are dropped unread, the others are opened and decoded, or dropped and counted.

A process has one for each of its PubSub connections: each has keys and replay windows of its own, and may be one by
which some spaces do not come.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final

from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import RemoteWireError
from ua_fleet.pubsub.complaints import Complaints
from ua_fleet.pubsub.origins import NO_ORIGINS, Origins
from ua_fleet.pubsub.publisher_ids import PublisherIds
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.wire import Codec, SecuredMessage
from ua_fleet.wire.generic import Decoded
from ua_fleet.wire.header import HAS_EXTENDED_FLAGS_1, HAS_EXTENDED_FLAGS_2, MESSAGE_TYPE_BITS, MessageType
from ua_fleet.wire.messages import NetworkMessage, Probe, PublisherIdType
from ua_fleet.wire.security import SecurityMode

__all__ = ["Inlet"]

_UINT16: Final = PublisherIdType.UINT16.value
_COUNT_AFTER: Final = 2
"""Where the number of DataSetMessages of a data message of ours stands, behind its GroupFlags."""


class Inlet:
    """Turns what a transport hands over into messages."""

    def __init__(
        self,
        own_space: int,
        counters: Counters,
        codec: Codec,
        complaints: Complaints,
        comes_in: Callable[[int], bool],
        *,
        envelope: Envelope | None = None,
        publisher_ids: PublisherIds | None = None,
        barred: Collection[int] = (),
        relayed: Origins = NO_ORIGINS,
        takes_actions: bool = True,
    ) -> None:
        """Make it.

        Args:
            own_space: the space of this process; a tool has a negative one.
            counters: what is dropped is counted here.
            codec: the process's codec.
            complaints: learns of what is malformed.
            comes_in: what the loop rule says to a publisher.
            envelope: opens what is received; without one, what is secured or a chunk is dropped.
            publisher_ids: of spaces that have another PublisherId on the wire.
            barred: spaces that do not come this way: their bridges are on other connections.
            relayed: what comes this way by relays alone, of spaces that are barred otherwise.
            takes_actions: whether Actions come this way.
        """
        self.opened: Callable[[bytes], None] | None = None
        """Told of each plain message before it is decoded."""
        self.impostor: Callable[[tuple[str, int], float], bool] | None = None
        """Told who has sent a message with our PublisherId, and when; whether that is somebody else."""
        self.is_incomplete = False
        """Whether the last datagram was a part of a message of which others are still to come."""
        self.envelope, self.takes_actions = envelope, takes_actions
        self.mode = SecurityMode.NONE if envelope is None else envelope.mode
        """What every message had that came in, probes apart."""
        self.heard_at: dict[int | str | None, float] = {}
        """When data of each publisher came last, where there are several connections; the longest known first."""
        self._barred, self._relayed = frozenset(barred), relayed
        self._admits_all = not (self._barred or self._relayed)
        self._own_space, self._counters, self._codec, self._complaints = own_space, counters, codec, complaints
        self._comes_in = comes_in
        own = own_space.to_bytes(2, "little") if own_space >= 0 else b""
        heads = (b"\xf1\x01" + own + b"\x01", b"\xf1\x11" + own + b"\x01") if own else ()
        self._own_heads = tuple([head if publisher_ids is None else publisher_ids.outward(head) for head in heads])
        """How the data that we send ourselves begins: it comes back by multicast, and is dropped unread. A tool has no
        space, and sends none."""

    def read(
        self, datagram: bytes, now: float, sender: tuple[str, int] | None = None, *, is_fresh: bool = True
    ) -> Decoded | None:
        """The message that a datagram is or completes; None where it is none, or was dropped and counted.

        Raises:
            DatagramRefused: it was not let in. That is not counted yet.
        """
        self.is_incomplete = False
        if not is_fresh and not _is_announcement(datagram):
            self._counters.drop(Drop.RETAINED)
            return None
        if datagram.startswith(self._own_heads) and not self._comes_in(self._own_space):
            count_at = _COUNT_AFTER + next(len(head) for head in self._own_heads if datagram.startswith(head))
            if len(datagram) > count_at:
                self._counters.messages_in += datagram[count_at]
                self._counters.drop(self._cause_of_own(datagram, sender, now), datagram[count_at])
                return None
        try:
            if self.envelope is not None:
                plain = self.envelope.open(datagram, now, is_fresh=is_fresh)
                if plain is None:
                    self.is_incomplete = True
                    return None
                datagram = plain
            if self.opened is not None:
                self.opened(datagram)
            message = self._codec.decode(datagram)
        except DatagramRefused:
            raise
        except SecuredMessage:
            self._counters.drop(Drop.SECURED)
        except RemoteWireError as error:
            self._counters.drop_malformed(error.cause)
            self._complaints.add(error)
        else:
            return message if self._admits_all else self._admitted(message)
        return None

    def hear(self, publisher_id: int | str | None, now: float, most: int) -> None:
        """Note that a publisher is heard; of more than so many the longest known goes."""
        if publisher_id not in self.heard_at and len(self.heard_at) >= most:
            del self.heard_at[next(iter(self.heard_at))]
        self.heard_at[publisher_id] = now

    def bars(self, space: int) -> bool:
        """Whether a space does not come this way."""
        return space in self._barred

    def relays(self, publisher_id: int | str | None, publisher_id_type: int = _UINT16) -> bool:
        """Whether what comes this way of a publisher is said by a relay."""
        return self._relayed.names(publisher_id, publisher_id_type)

    def _admitted(self, message: Decoded) -> Decoded | None:
        """What of a message may come this way; the rest is counted. A probe asks a space, and is of nobody."""
        publisher = message.publisher_id
        if message.publisher_id_type != _UINT16 or isinstance(message, Probe):
            return message
        if self._relayed.names(publisher):
            admitted = self._relayed.of(message)
        elif publisher in self._barred:
            admitted = None
        else:
            return message
        if lost := _count(message) - _count(admitted):
            self._counters.drop(Drop.NOT_ITS_CONNECTION, lost)
        return admitted

    def _cause_of_own(self, datagram: bytes, sender: tuple[str, int] | None, now: float) -> Drop:
        """Whether a message with our PublisherId came back to us, or is another process's that has our keys."""
        if sender is None or self.impostor is None:
            return Drop.LOOP
        if self.envelope is not None and not self.envelope.is_of_another(datagram, now):
            return Drop.LOOP
        return Drop.CONFLICT if self.impostor(sender, now) else Drop.LOOP


def _count(message: Decoded | None) -> int:
    """How many messages one is; of data so many as there are DataSetMessages."""
    if message is None:
        return 0
    return len(message.messages) if isinstance(message, NetworkMessage) else 1


def _is_announcement(datagram: bytes) -> bool:
    """Whether a datagram says that it is an announcement, secured or not."""
    return (
        len(datagram) > 2
        and bool(datagram[0] & HAS_EXTENDED_FLAGS_1)
        and bool(datagram[1] & HAS_EXTENDED_FLAGS_2)
        and datagram[2] & MESSAGE_TYPE_BITS == MessageType.ANNOUNCEMENT << 2
    )
