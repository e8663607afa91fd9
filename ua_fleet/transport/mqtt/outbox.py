"""What of a process goes to a broker, and when: pure, time is an argument.

    what           no connection                     room in the window     no room
    KEPT           the newest of each topic waits    sent, and kept         the newest of each topic waits
    VALUE          waits                             sent                   waits
      keep-alive   needed by nobody                  sent                   waits, unless more of its writer does
    COMMAND        dropped (broker_away)             sent                   waits for its lifetime, then expired

    connected      all that is kept goes again first, then the values that wait, in their order, secured anew
    renewed        all that is kept goes again: under a new key, who has only that one could not read it otherwise
    disconnected   commands are dropped; values that were not acknowledged wait again, in their place

Values wait in the order in which they came, up to `most_bytes` and `most_age_s`. Beyond that an older value goes for a
newer one of its writer (broker_away), so that what waits for long is the newest of each writer; where even these are
too many, the oldest go. What is in flight is bounded by the window, in messages and bytes. Where the oldest message in
flight is not acknowledged for `stuck_s`, the broker does not answer: the connection is to be made anew.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from typing import Final

from ua_fleet.counters import Drop
from ua_fleet.transport.mqtt.subject import Lane, Subject
from ua_fleet.transport.mqtt.topics import Kind

__all__ = ["KEPT_FOR_S", "Outbox", "Parcel"]

KEPT_FOR_S: Final = 180
"""Message Expiry Interval of what the broker retains (OPC 10000-14 7.3.4.8); it is sent again three times meanwhile."""
MOST_COMMANDS: Final = 1_000
WINDOW_MESSAGES: Final = 500
WINDOW_BYTES: Final = 2 * 1024 * 1024
STUCK_S: Final = 5.0

_Origin = tuple[int | str | None, tuple[int | None, int] | None]
"""See `Subject.origin`."""


@dataclass(slots=True, eq=False)
class Parcel:
    """One MQTT message that is to be sent."""

    subject: Subject
    payload: bytes | None
    """Secured bytes; None where it is to be secured when it is sent, as what is kept."""
    plain: bytes
    """Of which message it is; empty bytes clear what the broker retains under the topic."""
    arrived: float
    topic: str = ""
    """Where it goes, if not to the topic of its subject: a response may be wanted elsewhere."""
    sent_at: float = 0.0
    is_sent: bool = False
    has_waited: bool = False
    """It is a value that was secured before there was a connection, and that no broker has had.

    It is secured anew: what is kept goes before it with a higher number, after which who hears us for the first time
    takes no lower one.
    """

    @property
    def size(self) -> int:
        """About the memory that it takes."""
        return len(self.plain if self.payload is None else self.payload) + 200

    @property
    def deadline(self) -> float | None:
        """When it is worth nothing any more."""
        return None if self.subject.lifetime_s is None else self.arrived + self.subject.lifetime_s


class _Newest:
    """The newest message of a writer, and how many parts of it wait."""

    __slots__ = ("parts", "plain")

    def __init__(self, plain: bytes) -> None:
        self.plain, self.parts = plain, 0


class Outbox:
    """See the module."""

    def __init__(
        self,
        *,
        most_bytes: int = 64 * 1024 * 1024,
        most_age_s: float = 2.0,
        window_messages: int = WINDOW_MESSAGES,
        stuck_s: float = STUCK_S,
    ) -> None:
        """Make an empty outbox without a connection.

        Args:
            most_bytes: of values that wait.
            most_age_s: so long all values wait, and beyond that only the newest of each writer.
            window_messages: most messages in flight.
            stuck_s: so long an acknowledgement may take.
        """
        self.drops: dict[Drop, int] = {}
        """What was dropped, by cause."""
        self._most_bytes, self._most_age_s, self._stuck_s = most_bytes, most_age_s, stuck_s
        self._most_in_flight = self._window = window_messages
        self._is_connected = False
        self._kept: dict[str, Parcel] = {}
        """What the broker is to retain, by topic, in the order of its first announcement."""
        self._due: OrderedDict[str, Parcel] = OrderedDict()
        """What of it is to be sent, and what is to be cleared."""
        self._commands: deque[Parcel] = deque()
        self._values: deque[Parcel] = deque()
        self._last: OrderedDict[_Origin, deque[Parcel]] = OrderedDict()
        """The newest value of each writer, of those that are too old to wait in the row."""
        self._newest: dict[_Origin, _Newest] = {}
        """The newest message of each writer that waits."""
        self._value_bytes = 0
        self._flying: dict[Parcel, None] = {}
        """In the order in which it was sent."""
        self._flying_bytes = 0

    def put(self, parcel: Parcel, now: float) -> None:
        """Take a message that is to be sent."""
        lane = parcel.subject.lane
        if lane is Lane.KEPT:
            topic = parcel.subject.topic
            self._kept[topic] = self._due[topic] = parcel
        elif lane is Lane.VALUE:
            # It says that its writer lives now. The next one says so later, and what waits has more to say.
            if parcel.subject.is_keep_alive and (not self._is_connected or parcel.subject.origin in self._newest):
                return
            self._put_value(parcel)
            self._trim(now)
        elif not self._is_connected or len(self._commands) >= MOST_COMMANDS:
            self._drop(Drop.BROKER_AWAY)
        else:
            self._commands.append(parcel)

    def take(self, now: float) -> Iterator[Parcel]:
        """What is to be sent now, commands first; each is in flight from then on. To be used up at once."""
        while self._is_connected and len(self._flying) < self._window and self._flying_bytes < WINDOW_BYTES:
            parcel = self._next(now)
            if parcel is None:
                return
            parcel.sent_at, parcel.is_sent = now, True
            self._flying[parcel] = None
            self._flying_bytes += parcel.size
            yield parcel

    def acknowledged(self, parcel: Parcel) -> None:
        """A message in flight has arrived at the broker, or was refused there."""
        if parcel in self._flying:
            del self._flying[parcel]
            self._flying_bytes -= parcel.size

    def not_secured(self, parcel: Parcel) -> None:
        """What is kept could not be secured: it waits for a key (`renewed`)."""
        self.acknowledged(parcel)

    def expired(self, parcel: Parcel) -> bool:
        """Drop a parcel if it is a value that nobody can answer for, which an event is not; says whether it was."""
        if parcel.subject.lane is not Lane.VALUE or parcel.subject.is_event:
            return False
        self.acknowledged(parcel)
        self._drop(Drop.EXPIRED)
        return True

    def connected(self, now: float, receive_maximum: int = 65_535) -> None:
        """There is a connection: everything that is kept goes again, with a status that says so.

        Args:
            now: the time.
            receive_maximum: so many messages the broker takes in flight. More would wait in the client, where no
                command overtakes them.
        """
        self._is_connected = True
        self._window = min(self._most_in_flight, receive_maximum)
        for parcel in chain(self._values, *self._last.values()):
            parcel.has_waited = not parcel.is_sent
        self.renewed(now)

    def renewed(self, now: float) -> None:
        """Send everything that is kept again."""
        for topic in list(self._kept):
            self.again(topic, now)

    def again(self, topic: str, now: float) -> None:
        """Send what is kept of a topic again, secured anew: a nonce is used once."""
        parcel = self._kept[topic]
        self._due.pop(topic, None)
        self._kept[topic] = self._due[topic] = Parcel(parcel.subject, None, parcel.plain, now)

    def disconnected(self) -> None:
        """There is no connection any more."""
        self._is_connected = False
        flying = sum(parcel.subject.lane is Lane.COMMAND for parcel in self._flying)
        self._drop(Drop.BROKER_AWAY, len(self._commands) + flying)
        self._commands.clear()
        again = [
            parcel for parcel in self._flying if parcel.subject.lane is Lane.VALUE and not parcel.subject.is_keep_alive
        ]
        for parcel in reversed(again):
            self._values.appendleft(parcel)
            self._value_bytes += parcel.size
            newest = self._newest.setdefault(parcel.subject.origin, _Newest(parcel.plain))
            newest.parts += newest.plain is parcel.plain
        waiting = set(self._due)
        for parcel in self._flying:
            topic = parcel.subject.topic
            if parcel.subject.lane is Lane.KEPT and topic not in waiting and self._kept.get(topic) is not parcel:
                self._due[topic] = parcel  # what was to be cleared: the last that was sent of a topic counts
        self._flying.clear()
        self._flying_bytes = 0

    def clear(self, topic: str, kind: Kind, now: float) -> None:
        """Have the broker retain nothing under a topic any more."""
        self._kept.pop(topic, None)
        self._due[topic] = Parcel(Subject(topic, Lane.KEPT, kind), b"", b"", now)

    def kept(self) -> dict[str, Subject]:
        """What the broker is to retain, by topic."""
        return {topic: parcel.subject for topic, parcel in self._kept.items()}

    def poll(self, now: float) -> None:
        """Drop what is too late, and send what the broker would soon forget again."""
        self._drop_expired(now)
        self._trim(now)
        for topic, parcel in list(self._kept.items()):
            if parcel.is_sent and topic not in self._due and now - parcel.sent_at >= KEPT_FOR_S / 3:
                self.again(topic, now)

    def is_stuck(self, now: float) -> bool:
        """Whether the broker does not acknowledge what it was sent."""
        first = next(iter(self._flying), None)
        return first is not None and now - first.sent_at > self._stuck_s

    @property
    def in_flight(self) -> int:
        """Messages that were sent and not acknowledged."""
        return len(self._flying)

    @property
    def waiting(self) -> int:
        """Messages that wait."""
        return len(self._due) + len(self._commands) + len(self._values) + sum(map(len, self._last.values()))

    @property
    def waiting_bytes(self) -> int:
        """About the memory of the values that wait."""
        return self._value_bytes

    def take_drops(self) -> dict[Drop, int]:
        """What was dropped since this was asked last."""
        drops, self.drops = self.drops, {}
        return drops

    def _next(self, now: float) -> Parcel | None:
        self._drop_expired(now)
        if self._commands:
            return self._commands.popleft()
        if self._due:
            return self._due.popitem(last=False)[1]
        if self._last:
            writer, row = next(iter(self._last.items()))
            parcel = row.popleft()
            if not row:
                del self._last[writer]
        elif self._values:
            parcel = self._values.popleft()
        else:
            return None
        self._gone(parcel)
        return parcel

    def _gone(self, parcel: Parcel) -> None:
        """A value does not wait any more."""
        self._value_bytes -= parcel.size
        newest = self._newest.get(parcel.subject.origin)
        if newest is not None and newest.plain is parcel.plain:
            newest.parts -= 1
            if not newest.parts:
                del self._newest[parcel.subject.origin]

    def _put_value(self, parcel: Parcel) -> None:
        writer = parcel.subject.origin
        older = self._last.get(writer)
        if older is not None and older[0].plain is not parcel.plain:
            del self._last[writer]
            self._forget(older)
        if older is not None and older[0].plain is parcel.plain:
            older.append(parcel)
        else:
            self._values.append(parcel)
        newest = self._newest.get(writer)
        if newest is None or newest.plain is not parcel.plain:
            newest = self._newest[writer] = _Newest(parcel.plain)
        newest.parts += 1
        self._value_bytes += parcel.size

    def _trim(self, now: float) -> None:
        values = self._values
        while values and (self._value_bytes > self._most_bytes or now - values[0].arrived > self._most_age_s):
            parcel = values.popleft()
            writer = parcel.subject.origin
            newest = self._newest.get(writer)
            if newest is not None and newest.plain is parcel.plain:
                self._last.setdefault(writer, deque()).append(parcel)
            else:
                self._forget([parcel])
        while self._value_bytes > self._most_bytes and self._last:
            self._forget(self._last.popitem(last=False)[1])

    def _forget(self, parcels: Iterable[Parcel]) -> None:
        """Drop values that wait no more in their row."""
        for parcel in parcels:
            self._gone(parcel)
            self._drop(Drop.BROKER_AWAY)

    def _drop_expired(self, now: float) -> None:
        commands = self._commands
        if any((deadline := parcel.deadline) is not None and deadline <= now for parcel in commands):
            left = [parcel for parcel in commands if parcel.deadline is None or parcel.deadline > now]
            self._drop(Drop.EXPIRED, len(commands) - len(left))
            self._commands = deque(left)

    def _drop(self, cause: Drop, count: int = 1) -> None:
        if count:
            self.drops[cause] = self.drops.get(cause, 0) + count
