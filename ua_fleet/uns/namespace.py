"""The values of a Unified Namespace, and what of them is due on the broker: pure, `now` is monotonic seconds.

    a robot comes       its topics are there at once, without a value
    a value changes     at most `rate_hz` times a second where it is a number of the same quality; the last one is due,
                        and goes in turn with what is only said again, however much of that waits
    connected           everything is due: a broker may have lost what it retained, and has what an earlier server said
    sent                due again after a third of the expiry, so that the broker never drops what is true
    a robot goes        its topics are cleared
    the end             nothing is of now any more: every value is Bad, the server is offline

At most `MOST_PER_S` messages are sent in a second, so that a connection with a hundred thousand topics keeps no command
waiting.

Of each topic only the newest value waits, and it is written as JSON when it is sent. So what waits while the broker is
away takes no more memory than the values themselves, and a value that gave way to a newer one is counted.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from ua_fleet.counters import Drop
from ua_fleet.errors import LocalWireError
from ua_fleet.fleet.changes import ValueChanged
from ua_fleet.fleet.coalesce import Coalescer
from ua_fleet.fleet.model import RobotModel
from ua_fleet.rate import Budget
from ua_fleet.topics import Topic
from ua_fleet.transport.mqtt.core import Heard, Outgoing
from ua_fleet.transport.mqtt.outbox import STUCK_S, WINDOW_BYTES, WINDOW_MESSAGES
from ua_fleet.uns.payloads import CLEARED, Payload, encode_payload
from ua_fleet.uns.topics import NamespaceTopics
from ua_fleet.values import BuiltinType, NodeId, StatusCode

__all__ = ["ROBOT_TOPICS", "Namespace"]

ROBOT_TOPICS: Final = ("_state", "_task", "_fault")
"""What the server itself says of each robot."""
ONLINE: Final = "online"
OFFLINE: Final = "offline"
MOST_PER_S: Final = 2000
"""Messages: the server has other work, which they may not keep. Its end is not held back."""
BURST: Final = 500
_QOS: Final = 1
_STRING: Final = int(BuiltinType.STRING)
_STATUS: Final = int(BuiltinType.STATUS_CODE)
_WAITING: Final = int(StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
_NO_COMMUNICATION: Final = int(StatusCode.BAD_NO_COMMUNICATION)
_ENCODING: Final = int(StatusCode.BAD_ENCODING_ERROR)
_TOO_LARGE: Final = int(StatusCode.BAD_REQUEST_TOO_LARGE)


class _Entry:
    """One topic with its last value."""

    __slots__ = ("is_new", "key", "sent_at", "topic", "value")

    def __init__(self, key: NodeId, topic: str) -> None:
        self.key, self.topic = key, topic
        self.value = ValueChanged(key, 0, None, _WAITING, None, False)
        self.is_new = False
        """Whether the value has come and was never sent."""
        self.sent_at = 0.0


class _Flight:
    """A message that was sent and not acknowledged."""

    __slots__ = ("entry", "sent_at", "size", "topic", "value")

    def __init__(self, topic: str, entry: _Entry | None, size: int, sent_at: float) -> None:
        self.topic, self.entry, self.size, self.sent_at = topic, entry, size, sent_at
        self.value = None if entry is None else entry.value


class Namespace:
    """See the module. It is `transport.mqtt.carried.Carried`."""

    def __init__(
        self,
        topics: NamespaceTopics,
        form: Payload,
        *,
        rate_hz: float,
        expiry_s: float,
        max_payload_bytes: int,
        wall_ticks: Callable[[], int],
    ) -> None:
        """Make one without robots.

        Args:
            topics: of the fleet.
            form: how values look.
            rate_hz: how often a number is published at most.
            expiry_s: so long the broker retains what is not said again (MQTT 5).
            max_payload_bytes: a larger value is not published.
            wall_ticks: the wall clock.
        """
        self._topics, self._form, self._expiry_s, self._wall_ticks = topics, form, expiry_s, wall_ticks
        self._max_payload_bytes = max_payload_bytes
        self._coalescer = Coalescer(rate_hz)
        self._held: set[NodeId] = set()
        """Whose newest value waits for its turn in the coalescer."""
        self._entries: dict[NodeId, _Entry] = {}
        self._fields: dict[Topic, tuple[NodeId, ...]] = {}
        """Of data that clients write."""
        self._robots: dict[str, tuple[RobotModel, tuple[NodeId, ...]]] = {}
        self._news: OrderedDict[_Entry, None] = OrderedDict()
        """Whose value is new."""
        self._due: OrderedDict[_Entry, None] = OrderedDict()
        """What is to be said once more."""
        self._is_repeats_turn = False
        """Whether the last one was new. Where new values never end, a broker would keep or forget all others."""
        self._fresh: OrderedDict[_Entry, None] = OrderedDict()
        """What the broker has, the oldest first."""
        self._gone: OrderedDict[str, None] = OrderedDict()
        """Topics that are to be cleared."""
        self._budget = Budget(MOST_PER_S, BURST)
        self._flying: OrderedDict[_Flight, None] = OrderedDict()
        self._flying_bytes = 0
        self._window = WINDOW_MESSAGES
        self._is_connected = False
        self._is_ended = False
        self._server_due, self._server_sent_at = False, 0.0
        self._drops: dict[Drop, int] = {}
        self.published = 0
        """Messages that the broker has acknowledged."""
        self.malformed = Counter[str]()
        self.details: dict[str, str] = {}

    # What the server tells.

    def add(self, robot: RobotModel) -> None:
        """A robot is there, and nothing is known of its values yet."""
        keys: list[NodeId] = []
        for data_set in robot.data_sets:
            for field in data_set.fields:
                self._entries[field.key] = _Entry(field.key, self._topics.of_field(robot.name, data_set, field))
                keys.append(field.key)
            if data_set.writable:
                self._fields[data_set.topic] = tuple([field.key for field in data_set.fields])
        for name in ROBOT_TOPICS:
            key = robot.part(name)
            self._entries[key] = _Entry(key, self._topics.topic(robot.name, name))
            keys.append(key)
        self._robots[robot.name] = robot, tuple(keys)
        for key in keys:
            entry = self._entries[key]
            self._gone.pop(entry.topic, None)
            self._repeat(entry)

    def remove(self, name: str) -> None:
        """A robot is gone, and its topics with it."""
        robot, keys = self._robots.pop(name)
        self._coalescer.forget(keys)
        self._held.difference_update(keys)
        for data_set in robot.data_sets:
            self._fields.pop(data_set.topic, None)
        for key in keys:
            entry = self._entries.pop(key)
            for waiting in (self._news, self._due, self._fresh):
                waiting.pop(entry, None)
            self._gone[entry.topic] = None

    def changed(self, change: ValueChanged, now: float) -> None:
        """A value, its quality or its time has changed; of a node that is no robot's data nothing is said."""
        if change.key not in self._entries or self._is_ended:
            return
        ready = self._coalescer.offer(change, now)
        was_held = change.key in self._held
        if was_held:
            self._drop(Drop.RATE_LIMITED)
        if ready is None:
            self._held.add(change.key)
            return
        if was_held:
            self._held.discard(change.key)
        self._put(ready)

    def written(self, topic: Topic, types: Sequence[int], values: Sequence[Any], ticks: int, now: float) -> None:
        """Clients have written data of a robot."""
        for key, type_code, value in zip(self._fields.get(topic, ()), types, values, strict=False):
            if type_code == _STATUS:  # of a field that nobody has written yet
                self.changed(ValueChanged(key, 0, None, int(value), ticks, False), now)
            else:
                self.changed(ValueChanged(key, type_code, value, 0, ticks, False), now)

    def told(self, robot: str, state: str, task: str, fault: str) -> None:
        """What the server says of a robot; said again it changes nothing."""
        known = self._robots.get(robot)
        if known is None or self._is_ended:
            return
        for name, text in zip(ROBOT_TOPICS, (state, task, fault), strict=True):
            entry = self._entries[known[0].part(name)]
            if entry.value.value != text:
                self._put(ValueChanged(entry.key, _STRING, text, 0, self._wall_ticks(), False))

    def end(self) -> None:
        """The server ends, and what it said is not of now any more."""
        if self._is_ended:
            return
        self._is_ended = self._server_due = True
        for entry in self._entries.values():
            entry.value = entry.value._replace(status=_NO_COMMUNICATION)
            self._repeat(entry)

    def next_deadline(self) -> float | None:
        """When `poll` and `take` are to be called next, or None."""
        due = self._coalescer.next_deadline()
        if not self.waiting or not self._is_connected or len(self._flying) >= self._window:
            return due
        return self._budget.at() if due is None else min(due, self._budget.at())

    @property
    def topics(self) -> int:
        """Topics of robots that there are."""
        return len(self._entries)

    @property
    def waiting(self) -> int:
        """Topics whose newest value the broker does not have."""
        return len(self._news) + len(self._due) + len(self._gone) + self._server_due

    # What the transport asks: see Carried.

    @property
    def filters(self) -> Mapping[str, int]:
        """Nothing: what somebody writes there moves nothing."""
        return {}

    @property
    def status_topic(self) -> str:
        """See Carried."""
        return self._topics.server

    def will(self, now: float) -> bytes:
        """See Carried. When it will be true nobody knows yet, so it has no time."""
        del now
        return encode_payload(self._form, _STRING, OFFLINE, 0, None)

    def connected(self, now: float, receive_maximum: int = 65_535) -> None:
        """See Carried."""
        del now
        self._is_connected, self._window = True, min(WINDOW_MESSAGES, receive_maximum)
        self._server_due = True
        for entry in self._entries.values():
            self._repeat(entry)

    def disconnected(self) -> None:
        """See Carried."""
        self._is_connected = False
        for flight in self._flying:
            if flight.entry is None:
                if flight.topic != self._topics.server:
                    self._gone[flight.topic] = None
            elif flight.value is not flight.entry.value:
                self._drop(Drop.BROKER_AWAY)  # it may have arrived, and nobody has said so
        self._flying.clear()
        self._flying_bytes = 0

    def received(self, topic: str, payload: bytes, now: float, *, is_retained: bool) -> Sequence[Heard]:
        """See Carried."""
        del topic, payload, now, is_retained
        return ()

    def late(self, now: float) -> Sequence[Heard]:
        """See Carried."""
        del now
        return ()

    def take(self, now: float) -> Iterator[Outgoing]:
        """See Carried."""
        while self._is_connected and len(self._flying) < self._window and self._flying_bytes < WINDOW_BYTES:
            if not self.waiting or not (self._is_ended or self._budget.take(now)):
                return
            if self._server_due:
                self._server_due, self._server_sent_at = False, now
                yield self._fly(self._topics.server, None, self._server(), now)
            elif self._gone:
                topic, _ = self._gone.popitem(last=False)
                yield self._fly(topic, None, CLEARED, now)
            else:
                is_repeat = bool(self._due) and (self._is_repeats_turn or not self._news)
                entry, _ = (self._due if is_repeat else self._news).popitem(last=False)
                self._is_repeats_turn = not is_repeat
                entry.is_new, entry.sent_at = False, now
                self._fresh[entry] = None
                self._fresh.move_to_end(entry)
                yield self._fly(entry.topic, entry, self._payload(entry), now)

    def acknowledged(self, parcel: Any, *, is_refused: bool = False) -> None:
        """See Carried."""
        if parcel not in self._flying:
            return
        del self._flying[parcel]
        self._flying_bytes -= parcel.size
        if is_refused:
            self._drop(Drop.BROKER_REFUSED)
        else:
            self.published += 1

    def poll(self, now: float) -> None:
        """See Carried."""
        for change in self._coalescer.poll(now):
            self._held.discard(change.key)
            if change.key in self._entries and not self._is_ended:
                self._put(change)
        if self._is_ended:
            return
        before = now - self._expiry_s / 3
        if self._server_sent_at <= before and self._is_connected:
            self._server_due = True
        while self._fresh and (entry := next(iter(self._fresh))).sent_at <= before:
            del self._fresh[entry]
            self._repeat(entry)

    def clear_all(self, now: float) -> None:
        """See Carried: `end` has said already that nothing is of now, and that stays true."""
        del now

    @property
    def is_empty(self) -> bool:
        """See Carried."""
        return not self._flying and not self.waiting

    def is_stuck(self, now: float) -> bool:
        """See Carried."""
        first = next(iter(self._flying), None)
        return first is not None and now - first.sent_at > STUCK_S

    def take_drops(self) -> dict[Drop, int]:
        """See Carried."""
        drops, self._drops = self._drops, {}
        return drops

    def take_forgiven(self) -> Counter[str]:
        """See Carried."""
        return Counter()

    # Entries.

    def _put(self, change: ValueChanged) -> None:
        """A value is the newest of its topic."""
        entry = self._entries[change.key]
        if entry.is_new:
            self._drop(Drop.BROKER_AWAY)
        entry.value, entry.is_new = change, True
        self._due.pop(entry, None)
        self._news.setdefault(entry)

    def _repeat(self, entry: _Entry) -> None:
        """Say what an entry has once more."""
        if entry not in self._news:
            self._due.setdefault(entry)

    def _payload(self, entry: _Entry) -> bytes:
        _, type_code, value, status, ticks, _ = entry.value
        ticks = self._wall_ticks() if ticks is None else ticks
        try:
            payload = encode_payload(self._form, type_code, value, status, ticks)
        except LocalWireError as error:
            self._drop(Drop.CONVERSION)
            self.details["conversion"] = f"{entry.topic}: {error}"
            return encode_payload(self._form, 0, None, _ENCODING, ticks)
        if len(payload) <= self._max_payload_bytes:
            return payload
        self._drop(Drop.BROKER_REFUSED)
        self.details["broker_refused"] = (
            f"{entry.topic}: {len(payload)} bytes, and `max_payload_bytes` is {self._max_payload_bytes}"
        )
        return encode_payload(self._form, 0, None, _TOO_LARGE, ticks)

    def _server(self) -> bytes:
        text = OFFLINE if self._is_ended else ONLINE
        return encode_payload(self._form, _STRING, text, 0, self._wall_ticks())

    def _fly(self, topic: str, entry: _Entry | None, payload: bytes, now: float) -> Outgoing:
        flight = _Flight(topic, entry, len(payload) + len(topic) + 100, now)
        self._flying[flight] = None
        self._flying_bytes += flight.size
        stays = not payload or (topic == self._topics.server and self._is_ended)
        expiry_s = None if stays else math.ceil(self._expiry_s)
        return Outgoing(flight, topic, payload, _QOS, True, None, expiry_s)

    def _drop(self, cause: Drop) -> None:
        self._drops[cause] = self._drops.get(cause, 0) + 1
