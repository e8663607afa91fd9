"""The last messages of a process, opened, for people who look: kept only while somebody asks for them.

    recent = RecentMessages()
    recent.ask(who, source, after, now)          -> what has come since `after`; the first time it begins to be kept
    recent.received / sent(...)                  only while `recent.is_wanted`

Each person has for each source a ring of their own, so that what one looks for is not displaced by what another looks
at. What nobody has asked for since HOLD_S is forgotten. A message is kept as it was on the wire with what was encrypted
in plain; keys are no part of it. Pure: time is an argument.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ua_fleet.errors import RemoteWireError, TopicInvalid, UaFleetError
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.outline import is_chunk
from ua_fleet.wire.security import SecuredDatagram, SecurityMode, opened_form, read_security

__all__ = ["RecentAnswer", "RecentMessage", "RecentMessages", "TooManyLook"]

HOLD_S: Final = 15.0
"""So long a ring is kept after it was asked for."""
MOST_RINGS: Final = 8
MOST_RINGS_OF_ONE: Final = 4
MOST_MESSAGES: Final = 500
"""Of a ring."""
MOST_BYTES: Final = 1 << 20
"""Of the messages in a ring."""
MOST_MESSAGE_BYTES: Final = 4096
"""Of a longer message the beginning is kept."""
MESSAGES_IN_ANSWER: Final = 200
BYTES_IN_ANSWER: Final = 1 << 18
LONGEST_SOURCE: Final = 256


class TooManyLook(UaFleetError):
    """As many look at messages as may."""

    ua_status = StatusCode.BAD_RESOURCE_UNAVAILABLE
    remedy = "Wait until another one has stopped looking at messages."


class RecentMessage(NamedTuple):
    """A message that was sent or received."""

    number: int
    """Rises with each message that is kept, for whomever."""
    ticks: int
    """When, by the wall clock."""
    is_sent: bool
    address: str
    """Where it came from, or went to alone; empty: it went to all."""
    data: bytes
    """Its beginning; where `is_open`, with what was encrypted in plain."""
    size: int
    """Bytes of the whole message."""
    is_open: bool
    """Else it is as it came, and was not let in."""
    mode: SecurityMode
    token_id: int
    in_chunks: bool
    """It came or went as several datagrams, and is shown put together, without their security."""
    dropped: str
    """Causes for which it, or a part of it, was dropped, with spaces between them; empty: none."""


class RecentAnswer(NamedTuple):
    """What somebody is told."""

    messages: Sequence[RecentMessage]
    lost: int
    """Messages that had no place, and were not told."""
    begins: bool
    """Nothing was kept before: it begins now."""
    has_more: bool


@dataclass(slots=True)
class _Ring:
    who: str
    source: str
    topic: Topic | None
    until: float
    kept: deque[RecentMessage] = field(default_factory=deque[RecentMessage])
    size: int = 0
    lost: int = 0
    """The number of the last message that had to make room."""
    lost_count: int = 0

    def wants(self, heard: SecuredDatagram | None) -> bool:
        if not self.source:
            return True
        if heard is None:
            return False
        topic = self.topic
        if topic is None:
            return str(heard.publisher_id) == self.source
        is_its_group = (heard.publisher_id, heard.writer_group_id) == topic[:2]
        return is_its_group and topic.id in heard.writer_ids

    def put(self, message: RecentMessage) -> None:
        self.kept.append(message)
        self.size += len(message.data)
        while len(self.kept) > MOST_MESSAGES or self.size > MOST_BYTES:
            gone = self.kept.popleft()
            self.size -= len(gone.data)
            self.lost, self.lost_count = gone.number, self.lost_count + 1


class RecentMessages:
    """See the module."""

    def __init__(self) -> None:
        self._rings: dict[tuple[str, str], _Ring] = {}
        self._number = 0

    @property
    def is_wanted(self) -> bool:
        """Whether anybody looks."""
        return bool(self._rings)

    def ask(self, who: str, source: str, after: int, now: float) -> RecentAnswer:
        """What was kept for somebody since the message with the number `after`; it is kept from now on.

        Args:
            who: a name of the person who asks.
            source: whose messages: a PublisherId as a text, or a UA topic; empty: all.
            after: the number of the last message that was told; 0: all that are there.
            now: seconds.

        Raises:
            TooManyLook: others look at as much as is kept.
        """
        self.poll(now)
        ring = self._rings.get((who, source))
        if ring is None:
            self._make_room(who)
            self._rings[who, source] = _Ring(who, source, _topic(source), now + HOLD_S)
            return RecentAnswer((), 0, True, False)
        ring.until = now + HOLD_S
        if after > self._number:  # of another process that had this place before
            after = 0
        told: list[RecentMessage] = []
        size = 0
        for message in ring.kept:
            if message.number <= after:
                continue
            size += len(message.data)
            if len(told) >= MESSAGES_IN_ANSWER or (told and size > BYTES_IN_ANSWER):
                break
            told.append(message)
        lost = 0
        if ring.lost > after:
            lost, ring.lost_count = ring.lost_count, 0
        newest = ring.kept[-1].number if ring.kept else 0
        return RecentAnswer(told, lost, False, bool(told) and told[-1].number < newest)

    def _make_room(self, who: str) -> None:
        own = [key for key, ring in self._rings.items() if ring.who == who]
        if len(own) >= MOST_RINGS_OF_ONE:
            del self._rings[min(own, key=lambda key: self._rings[key].until)]
        elif len(self._rings) >= MOST_RINGS:
            raise TooManyLook(f"others look at messages of {MOST_RINGS} kinds already; try again when one has ended")

    def poll(self, now: float) -> None:
        """Forget what nobody has asked for any more."""
        for key in [key for key, ring in self._rings.items() if ring.until <= now]:
            del self._rings[key]

    def received(self, datagram: bytes, plain: bytes | None, ticks: int, address: str, dropped: str) -> None:
        """A datagram has come.

        Args:
            datagram: as it came.
            plain: the plain message that it is or completes; None: it was not let in, or completes none.
            ticks: when.
            address: where it came from.
            dropped: the causes for which it, or a part of it, was dropped.
        """
        if plain is None and not dropped:
            return  # a chunk of a message whose others are still to come, or what others ask each other
        self._take(datagram, plain, ticks, address, dropped, is_sent=False, in_chunks=is_chunk(datagram))

    def sent(self, plain: bytes, datagrams: Sequence[bytes], ticks: int, address: str) -> None:
        """A message was sent, as one datagram or as several chunks."""
        self._take(datagrams[0], plain, ticks, address, "", is_sent=True, in_chunks=len(datagrams) > 1)

    def _take(
        self,
        datagram: bytes,
        plain: bytes | None,
        ticks: int,
        address: str,
        dropped: str,
        *,
        is_sent: bool,
        in_chunks: bool,
    ) -> None:
        try:
            heard = read_security(datagram)
        except RemoteWireError:
            heard = None
        rings = [ring for ring in self._rings.values() if ring.wants(heard)]
        if not rings:
            return
        if plain is None or heard is None:
            data = datagram
        elif in_chunks or len(plain) > MOST_MESSAGE_BYTES:
            data = plain  # with the end cut off, a signature would be looked for where there is none
        else:
            data = opened_form(heard, plain)
        self._number += 1
        message = RecentMessage(
            self._number,
            ticks,
            is_sent,
            address,
            bytes(data[:MOST_MESSAGE_BYTES]),
            len(data),
            plain is not None,
            SecurityMode.NONE if heard is None else heard.mode,
            0 if heard is None else heard.token_id,
            in_chunks,
            dropped,
        )
        for ring in rings:
            ring.put(message)


def _topic(source: str) -> Topic | None:
    try:
        return Topic.parse(source)
    except TopicInvalid:
        return None
