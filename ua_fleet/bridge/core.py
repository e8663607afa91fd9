"""The bridge without I/O: what arrives on one side goes to the other, or is dropped by the loop rule and counted.

Time is an argument. What is to be sent and published goes through two callables, since effects as objects would cost
more than the work itself. The rule is asked in two places: here for what the space says, and in the subscriber for
what PubSub says.

A message whose status is Bad, or that says that a value is too old or a substitute (a recorded one), is not published
into the space: ROS has no way to say it. The same is true of a source that falls silent. Each is seen in the OPC UA
server.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Protocol

from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    ExecutionFact,
    SampleRead,
    SourceForgotten,
    SourceFound,
    SourceLost,
    SourceRead,
)
from ua_fleet.bridge.freshness import Freshness
from ua_fleet.bridge.wanted import Wants
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import FieldMissing, LocalWireError
from ua_fleet.pubsub.events import (
    ActionReceived,
    DataReceived,
    EventReceived,
    MetaDataReceived,
    ProbeDue,
    ProbeReceived,
    SetpointReceived,
    SourceReturned,
    SourceSilent,
    SourceStale,
    SourceUnknown,
    SubscriberEvent,
)
from ua_fleet.pubsub.metadata import NODE_ONLY, first_property, type_codes, with_max_age
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.subscriber import Subscriber
from ua_fleet.topics import LoopVerdict, Side, Topic, loop_verdict
from ua_fleet.values import BuiltinType, StatusCode, Variant, ticks_from_unix_ns
from ua_fleet.wire.actions import ActionMessage
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = [
    "NODE_ONLY",
    "ActionSide",
    "BridgeCore",
    "CarrySide",
    "PublishIntoSpace",
    "Rule",
    "SendDatagram",
    "SwitchSide",
    "TeleoperationSide",
]

Rule = Callable[[Side, int, int, bool], LoopVerdict]
"""`loop_verdict`, or what a test puts in its place."""
SendDatagram = Callable[[bytes], None]
PublishIntoSpace = Callable[[Topic, DataSetMetaData, DataSetMessage], bool]

_DROPS: Final = {
    LoopVerdict.DROP_LOOP: Drop.LOOP,
    LoopVerdict.DROP_FOREIGN: Drop.FOREIGN,
    LoopVerdict.DROP_OWN: Drop.OWN_PUBLICATION,
}
_REMEMBERED: Final = 16
"""Deliveries of each source that are remembered. Their Timestamps increase but where a source's clock is set back."""
_STATUS_CODE: Final = int(BuiltinType.STATUS_CODE)
_BAD: Final = int(StatusCode.BAD)
_LAST_USABLE: Final = int(StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE)
_NOT_OF_NOW: Final = (_LAST_USABLE >> 16, int(StatusCode.UNCERTAIN_SUBSTITUTE_VALUE) >> 16)
"""The upper halves of the statuses of a value that is too old, or that somebody has put in place of one."""


class ActionSide(Protocol):
    """What the core needs of the commands of a bridge: see `ua_fleet.bridge.actions`."""

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take a request."""
        ...

    def from_driver(self, fact: ExecutionFact, now: float) -> None:
        """Take what the driver tells of an execution."""
        ...

    def poll(self, now: float) -> None:
        """Do what is due."""
        ...

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        ...


class TeleoperationSide(Protocol):
    """What the core needs of robots that are driven by hand: see `ua_fleet.bridge.teleoperation`."""

    @property
    def topics(self) -> frozenset[Topic]:
        """The data that takes setpoints alone."""
        ...

    def takes(self, message: ActionMessage) -> bool:
        """Whether a request is about a lease."""
        ...

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take such a request."""
        ...

    def setpoint(self, event: SetpointReceived, now: float) -> None:
        """Take a setpoint."""
        ...


class SwitchSide(Protocol):
    """What the core needs of who disables and enables what the bridge sends: see `ua_fleet.bridge.switching`."""

    def takes(self, message: ActionMessage) -> bool:
        """Whether a request is for this."""
        ...

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take such a request."""
        ...

    def poll(self, now: float) -> None:
        """Do what is due."""
        ...

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        ...


class CarrySide(Protocol):
    """What the core needs of who carries runs here: see `ua_fleet.carrier`."""

    def begin(self, now: float) -> None:
        """Announce the Action, and go on where the journal ends."""
        ...

    def takes(self, message: ActionMessage) -> bool:
        """Whether an Action is for this: a word of a carried run, or the answer to one."""
        ...

    def receive(self, event: ActionReceived, now: float) -> None:
        """Take it."""
        ...

    def hear(self, event: SubscriberEvent, now: float) -> None:
        """Take what is heard of other spaces."""
        ...

    def own(self, datagram: bytes) -> None:
        """Take what this bridge says to all."""
        ...

    def poll(self, now: float) -> None:
        """Do what is due."""
        ...

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        ...

    @property
    def problem(self) -> str:
        """What keeps runs from going on here; empty where nothing does."""
        ...


class BridgeCore:
    """One bridge between a space and PubSub."""

    def __init__(
        self,
        space: int,
        publisher: Publisher,
        subscriber: Subscriber,
        counters: Counters,
        *,
        send: SendDatagram,
        publish: PublishIntoSpace,
        rule: Rule = loop_verdict,
        max_ages: Mapping[Topic, float] | None = None,
    ) -> None:
        """Connect the parts.

        Args:
            space: the space that the bridge stands in.
            publisher: the DataSetWriters of the space's sources.
            subscriber: the DataSetReaders of everything else, with the same rule.
            counters: where all of them count.
            send: sends a datagram over PubSub.
            publish: publishes a message into the space; says whether it could.
            rule: the loop rule.
            max_ages: maximum ages of sources, in seconds, where they are configured.
        """
        self.space, self.counters = space, counters
        self._publisher, self._subscriber, self._rule = publisher, subscriber, rule
        self._send, self._publish = send, publish
        self._types: dict[Topic, tuple[int, ...]] = {}
        """Type codes of the fields of each source of the space."""
        self._read: dict[Topic, int] = {}
        """The last timestamp of each source of the space. It was at the space side, and so were all before.

        Where the bridge's clock was ahead and was set right, what was read before has later ones.
        """
        self._published: dict[Topic, deque[int]] = {}
        """The latest timestamps of other spaces' sources that were published into the space."""
        self.freshness = Freshness(max_ages or {})
        """Which of the space's sources say what is too old."""
        self._unsayable: set[Topic] = set()
        """Sources of the space whose last message could not be sent: what was sent before it is not of now."""
        self._node_only: set[Topic] = set()
        self._bad: set[Topic] = set()
        """Other spaces' sources whose last message could not be published since it was Bad."""
        self.actions: ActionSide | None = None
        """The commands of this bridge; without, Actions are left alone."""
        self.teleoperation: TeleoperationSide | None = None
        """The robots of this bridge that are driven by hand, where there are some."""
        self.switches: SwitchSide | None = None
        """Who disables and enables what is sent; without, nobody does."""
        self.carrying: CarrySide | None = None
        """Who carries runs here, where somebody does."""
        self.wants: Wants | None = None
        """What the server wants of this bridge, where that reads on demand."""
        self.stale: Callable[[Topic, bool], None] | None = None
        """Told of other spaces' sources whose last value is not of now, where the driver answers for them."""
        self.dropped: Callable[[Dropped], None] = lambda event: counters.drop(event.cause, event.count)
        """Counts what could not be published, and tells of it."""
        self.caught: Callable[[str, Exception], None] | None = None
        """Told of a mistake that has cost one message, with the loop that it happened in; without, it is raised."""

    def sample(self, sample: SampleRead, now: float, arrived: float | None = None) -> SourceFound | None:
        """Take in a message of the space; `arrived` is when the driver had told it, where that is not now.

        Its source again where that has another maximum age from now on: for `from_space`.
        """
        topic, values, source_time_ns, status, own_publication, _ = sample
        self.counters.from_space += 1
        verdict = self._rule(Side.SPACE, topic.space, self.space, own_publication)
        if verdict is not LoopVerdict.TO_PUBSUB:
            self.counters.drop(_DROPS[verdict])
            return None
        ticks = ticks_from_unix_ns(source_time_ns)
        try:
            for datagram in self._encoded(topic, values, ticks, status, now):
                self._send(datagram)
            self._unsayable.discard(topic)
        except LocalWireError as error:
            status = self._could_not_say(topic, error, ticks, now)
        return self.freshness.told(topic, source_time_ns, status, now if arrived is None else arrived)

    def from_space(self, event: DriverEvent, *, now: float, wall_ticks: int, arrived: float | None = None) -> None:
        """Take in what the driver tells; see `sample`, which is the shorter way for most of it."""
        if isinstance(event, SampleRead):
            changed = self.sample(event, now, arrived)
            if changed is not None:
                self._found(changed, now, wall_ticks)
        elif isinstance(event, SourceFound):
            self._found(event, now, wall_ticks)
        elif isinstance(event, SourceLost):
            self._lost(event.topic, now, wall_ticks)
        elif isinstance(event, SourceForgotten):
            self._types.pop(event.topic, None)
            self._unsayable.discard(event.topic)
            self._publisher.retire(event.topic)
            self.freshness.forget(event.topic)
        elif isinstance(event, SourceRead):
            status = self.freshness.read(event.topic, now)
            if status is not None:
                self._restate(event.topic, status, ticks_from_unix_ns(event.source_time_ns), now)
        elif not isinstance(event, Dropped):
            if self.actions is not None:
                self.actions.from_driver(event, now)
        else:
            self.counters.drop(event.cause, event.count)

    def tell(self, topic: Topic, values: tuple[Any, ...], timestamp: int, status: int = 0, *, now: float) -> None:
        """Publish a message of an announced source. Its timestamp moves forward, or back if that was far ahead."""
        try:
            for datagram in self._encoded(topic, values, timestamp, status, now):
                self._send(datagram)
        except LocalWireError as error:
            self._could_not_say(topic, error, timestamp, now)

    def _could_not_say(self, topic: Topic, error: LocalWireError, timestamp: int, now: float) -> int:
        """Drop what cannot be sent. What was sent last is not of now then; its status, which is said once."""
        self.dropped(Dropped(Drop.CONVERSION, detail=str(error)))
        if topic not in self._unsayable:
            self._unsayable.add(topic)
            self._restate(topic, int(error.ua_status), timestamp, now)
        return int(error.ua_status)

    def _encoded(
        self, topic: Topic, values: tuple[Any, ...], timestamp: int, status: int, now: float
    ) -> Iterable[bytes]:
        types = self._types.get(topic)
        if types is None:
            self.counters.drop(Drop.NO_METADATA)
            return ()
        for value in values:
            if type(value) is Variant:  # a Bad field: its StatusCode in place of a value
                types, values = _unwrapped(types, values)
                break
        if timestamp <= (last := self._read.get(topic, -1)):
            timestamp = self._publisher.timestamps.after(topic, last, timestamp, now)
        datagrams = self._publisher.publish(topic, values, timestamp=timestamp, status=status, now=now, types=types)
        self._read[topic] = timestamp
        return datagrams

    def from_pubsub(
        self,
        datagram: bytes,
        *,
        now: float,
        sender: tuple[str, int] | None = None,
        is_fresh: bool = True,
        connection: int = 0,
    ) -> None:
        """Take in a datagram, and where it came from; `is_fresh` and `connection` as in `Subscriber.receive`."""
        events = self._subscriber.receive(datagram, now, sender, is_fresh=is_fresh, connection=connection)
        self._hear(events, now)

    def begin(self, *, now: float, wall_ticks: int) -> None:
        """Say on PubSub that this bridge is there."""
        for datagram in self._publisher.begin(now=now, wall_ticks=wall_ticks):
            self._send(datagram)

    def end(self) -> None:
        """Say on PubSub that this bridge ends."""
        for datagram in self._publisher.end():
            self._send(datagram)

    def poll(self, now: float, wall_ticks: int | None = None, *, is_round: bool = False) -> None:
        """Do what is due; `is_round` as in `Publisher.poll`."""
        for topic in self.freshness.take_stale(now):
            self._restate(topic, _LAST_USABLE, 0, now)
        for datagram in self._publisher.poll(now, wall_ticks, is_round=is_round):
            self._send(datagram)
        self._subscriber.caught = self.caught
        self._hear(self._subscriber.poll(now), now)
        if self.actions is not None:
            self.actions.poll(now)
        if self.switches is not None:
            self.switches.poll(now)
        if self.carrying is not None:
            self.carrying.poll(now)

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None."""
        ours, theirs = self._publisher.next_deadline(), self._subscriber.next_deadline()
        due = ours if theirs is None or (ours is not None and ours < theirs) else theirs
        stale_at = self.freshness.next_deadline()
        if stale_at is not None:
            due = stale_at if due is None else min(due, stale_at)
        for commands in (self.actions, self.switches, self.carrying):
            at = None if commands is None else commands.next_deadline()
            if at is not None:
                due = at if due is None else min(due, at)
        return due

    def _found(self, source: SourceFound, now: float, wall_ticks: int) -> None:
        if self._rule(Side.SPACE, source.topic.space, self.space, False) is not LoopVerdict.TO_PUBSUB:
            return
        fields = with_max_age(source.fields, self.freshness.found(source))
        try:
            datagrams = self._publisher.announce(source.topic, source.name, fields, now=now, wall_ticks=wall_ticks)
        except LocalWireError:
            self.counters.drop(Drop.CONVERSION)
            return
        self._types[source.topic] = type_codes(source.fields)
        for datagram in datagrams:
            self._send(datagram)

    def _restate(self, topic: Topic, status: int, timestamp: int, now: float) -> None:
        """Say the last values of a source with another status, as of now or as of the time that they had."""
        if timestamp <= (last := self._read.get(topic, -1)):
            timestamp = self._publisher.timestamps.after(topic, last, timestamp, now)
        for datagram in self._publisher.restate(topic, status=status, timestamp=timestamp, now=now):
            self._read[topic] = timestamp
            self._send(datagram)

    def _lost(self, topic: Topic, now: float, wall_ticks: int) -> None:
        self.freshness.lost(topic)
        timestamp = max(wall_ticks, self._read.get(topic, -1) + 1)
        for datagram in self._publisher.source_lost(topic, timestamp=timestamp, now=now):
            self._read[topic] = timestamp
            self._send(datagram)

    def hear(self, events: Iterable[SubscriberEvent], now: float) -> None:
        """Take what comes of reading that somebody has disabled."""
        self._hear(events, now)

    def _hear(self, events: Iterable[SubscriberEvent], now: float) -> None:
        for event in events:
            try:
                if self.carrying is not None:
                    self.carrying.hear(event, now)
                self._heard(event, now)
            except Exception as error:  # whatever a driver makes of one message, the others are behind it
                if self.caught is None:
                    raise
                self.caught("messages", error)

    def _heard(self, event: SubscriberEvent, now: float) -> None:
        wants = self.wants
        if wants is not None and isinstance(event, DataReceived | SourceSilent) and event.topic == wants.topic:
            wants.hear(event)
        elif isinstance(event, DataReceived | EventReceived):
            self._data(event)
        elif isinstance(event, SourceSilent | SourceStale | SourceReturned):
            if self.stale is not None:
                self.stale(event.topic, not isinstance(event, SourceReturned) or event.topic in self._bad)
        elif isinstance(event, SourceUnknown | ProbeDue):
            if event.datagram is not None:
                self._send(event.datagram)
        elif isinstance(event, ProbeReceived):
            for datagram in self._publisher.answer(event.probe, now):
                self._send(datagram)
        elif isinstance(event, SetpointReceived):
            if self.teleoperation is not None:
                self.teleoperation.setpoint(event, now)
        elif isinstance(event, ActionReceived):
            self._action(event, now)
        elif isinstance(event, MetaDataReceived):
            if first_property(event.metadata, NODE_ONLY):
                self._node_only.add(event.topic)
            else:
                self._node_only.discard(event.topic)

    def _action(self, event: ActionReceived, now: float) -> None:
        if self.carrying is not None and self.carrying.takes(event.message):
            self.carrying.receive(event, now)
        elif self.switches is not None and self.switches.takes(event.message):
            self.switches.receive(event, now)
        elif self.teleoperation is not None and self.teleoperation.takes(event.message):
            self.teleoperation.receive(event, now)
        elif self.actions is not None:
            self.actions.receive(event, now)

    def _data(self, event: DataReceived | EventReceived) -> None:
        topic, message, metadata = event
        if topic in self._node_only:
            return
        if self.teleoperation is not None and topic in self.teleoperation.topics:
            self.counters.drop(Drop.NOT_A_SETPOINT)
            return
        status = message.status or 0
        is_bad, has_bad_field = _is_unfit(status), _has_bad_field(message, metadata)
        if is_bad or has_bad_field:
            if not is_bad:
                self.counters.drop(Drop.CONVERSION)
            self._bad.add(topic)
            if self.stale is not None:
                self.stale(topic, True)
            return
        self._bad.discard(topic)
        try:
            if not self._publish(topic, metadata, message):
                return  # the driver has counted why
        except FieldMissing as error:
            self.dropped(Dropped(Drop.CONVERSION, detail=str(error)))
            return
        self.counters.to_space += 1
        if message.timestamp is not None:
            self._delivered(topic, message.timestamp)

    def _delivered(self, topic: Topic, timestamp: int) -> None:
        """Count a delivery of what was at the space side before."""
        published = self._published.get(topic)
        if published is None:
            published = self._published[topic] = deque(maxlen=_REMEMBERED)
        if timestamp <= self._read.get(topic, -1) or timestamp in published:
            self.counters.looped += 1
        else:
            published.append(timestamp)


def _is_unfit(status: int) -> bool:
    """Whether a message has no form in a space, which has no way to say such a status."""
    return bool(status & _BAD) or status >> 16 in _NOT_OF_NOW


def _unwrapped(types: tuple[int, ...], values: tuple[Any, ...]) -> tuple[tuple[int, ...], tuple[Any, ...]]:
    """Type codes and values where a Variant stands for a value of another type than its field's."""
    return (
        tuple(value.type if isinstance(value, Variant) else code for code, value in zip(types, values, strict=False)),
        tuple(value.value if isinstance(value, Variant) else value for value in values),
    )


def _has_bad_field(message: DataSetMessage, metadata: DataSetMetaData) -> bool:
    """Whether a field has a StatusCode in place of its value, or a Bad one beside it (OPC 10000-14 table 31)."""
    if message.field_status is not None and any(status & _BAD for status in message.field_status):
        return True
    return _STATUS_CODE in message.types and any(
        code == _STATUS_CODE != field.builtin_type for code, field in zip(message.types, metadata.fields, strict=False)
    )
