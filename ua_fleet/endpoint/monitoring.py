"""Monitored items: what a subscription watches, and what waits to be told of it.

A value is compared with the last one that was told, and queued as it is: no copy is made, and what a client wants of it
is cut out when it is sent. That is safe because every write to a node, ours and a client's, brings a fresh DataValue
that nobody changes afterwards; and it halves the cost of a notification.

Nothing is polled. An item whose sampling interval is 0 looks at each write; one that has an interval looks at what is
there when its time has come, and a value that is written before that waits, the last one alone (OPC 10000-4 5.13.1.2).
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import dataclasses
import functools
import math
import time
from abc import ABC, abstractmethod
from typing import Any, Final, Protocol

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.endpoint.answers import Misfit
from ua_fleet.endpoint.at_once import DONE, Done
from ua_fleet.endpoint.backlog import MOST_WAITING
from ua_fleet.endpoint.compact_nodes import HeldValue
from ua_fleet.endpoint.filters import EventFilter
from ua_fleet.endpoint.indexrange import IndexRange, apply_range, is_small
from ua_fleet.endpoint.notifications import change_bytes, event_bytes, kept_change_bytes
from ua_fleet.endpoint.queues import Account, content_bytes
from ua_fleet.endpoint.stack import AttributeIds, shown, status

__all__ = ["DataItem", "EventItem", "Item", "Owner"]

_OVERFLOW: Final = 0x0480
"""InfoType DataValue and the Overflow bit of a StatusCode (OPC 10000-4 7.39.1)."""


_NUMBERS: Final = (float, int)
_TEXTS: Final = (str, bytes)
_LISTS: Final = (list, tuple)
_DISABLED: Final = ua.MonitoringMode.Disabled
_REPORTING: Final = ua.MonitoringMode.Reporting
_STATUS_ALONE: Final = ua.DataChangeTrigger.Status
_WITH_TIME: Final = ua.DataChangeTrigger.StatusValueTimestamp
# Found once: each change of each item asks for them.
_ENTRY_BYTES: Final = 320
"""Of a notification of an empty value: the objects of asyncua that hold it."""
_FIELD_BYTES: Final = 150
"""Of a field of an event."""
_SMALL_PART: Final = 1_000
"""Elements or bytes of a part of an array that is compared by itself; larger ones are compared with all of it."""


def weight(notification: Any) -> int:
    """About the memory that a notification takes, in bytes. It does not change while it waits."""
    if isinstance(notification, ua.DataValue):
        variant = notification.Value
        content: Any = variant.Value if variant is not None else None
        if content is None or isinstance(content, _NUMBERS):
            return _ENTRY_BYTES
        if isinstance(content, _TEXTS):
            return _ENTRY_BYTES + len(content)
        return _ENTRY_BYTES + _content_bytes(_ByIdentity(content))
    return _ENTRY_BYTES + sum([_FIELD_BYTES + content_bytes(field.Value) for field in notification.EventFields])


class Owner(Protocol):
    """The subscription of an item."""

    def pending(self, item: Item) -> None:
        """An item that reports has something to tell that it had not before."""
        ...

    def fired(self, item: Item) -> None:
        """An item with triggering links has a notification."""
        ...

    def overflown(self, item: Item) -> None:
        """A notification of an item gave way to a newer one."""
        ...

    def hold(self, item: DataItem) -> None:
        """A value of an item waits until the next sample is due."""
        ...

    account: Account
    """What waits for the user."""


class Item(ABC):
    """What data and event items share: a queue of bounded length."""

    __slots__ = (
        "_lost_beside",
        "client_handle",
        "discard_oldest",
        "id",
        "is_owed",
        "links",
        "mode",
        "node_id",
        "owner",
        "queue",
        "queue_size",
    )

    def __init__(self, owner: Owner, item_id: int, request: ua.MonitoredItemCreateRequest, queue_size: int) -> None:
        self.owner = owner
        self.id = item_id
        self.node_id: ua.NodeId = request.ItemToMonitor.NodeId
        self.mode: ua.MonitoringMode = request.MonitoringMode
        self.client_handle: int = request.RequestedParameters.ClientHandle
        self.discard_oldest: bool = bool(request.RequestedParameters.DiscardOldest)
        self.queue_size = queue_size
        self.queue: list[Any] = []  # a deque takes 700 bytes when it is empty
        self.links: dict[int, None] | None = None
        """Ids of the items that are reported when this one has a notification (OPC 10000-4 5.13.1.6)."""
        self.is_owed = False
        """Whether all that waited gave way, and the value is to be told as it is then."""
        self._lost_beside = -1
        """Where in the queue something was lost; -1 for nowhere."""

    @property
    def waits(self) -> bool:
        """Whether there is something to tell."""
        return bool(self.queue) or self.is_owed

    def put(self, notification: Any) -> None:
        """Queue a notification; a full queue loses its oldest, or keeps it and loses the newest before this one."""
        queue, account = self.queue, self.owner.account
        is_lost = self.is_owed
        size = weight(notification)
        if len(queue) >= self.queue_size:
            lost = weight(queue.pop(0 if self.discard_oldest else -1))
            if lost != size or self not in account.items:
                account.release(lost)
            else:
                size = 0  # as much as it takes, and the item is among those that wait
            is_lost = True
            self.owner.overflown(self)
        elif not queue and not is_lost and self.mode is _REPORTING:
            self.owner.pending(self)
        self.is_owed = False
        queue.append(notification)
        if is_lost:
            self._lost_beside = 0 if self.discard_oldest else len(queue) - 1
        if size:
            account.hold(self, size)
        if self.links:
            self.owner.fired(self)

    def resize(self, queue_size: int) -> None:
        """Have another length of the queue; what it has no room for is lost."""
        while len(self.queue) > queue_size:
            self.owner.account.release(weight(self.queue.pop(0 if self.discard_oldest else -1)))
            self._lost_beside = 0 if self.discard_oldest else queue_size - 1
        self.queue_size = queue_size

    def give_way(self) -> bool:
        """Lose the oldest that waits, or the newest but one where the oldest are to stay; whether any is left."""
        queue = self.queue
        at = 0 if self.discard_oldest or len(queue) == 1 else -2
        self.owner.account.release(weight(queue.pop(at)))
        self._lost_beside = 0 if self.discard_oldest else len(queue) - 1
        if queue:
            return True
        self.is_owed = self.owes
        return False

    owes = False
    """Whether it can tell later what it has lost."""

    def take(self) -> Any:
        """The oldest notification, out of the queue."""
        notification = self.queue.pop(0)
        account = self.owner.account
        account.release(weight(notification))
        if not self.queue:
            account.leave(self)
        if self._lost_beside >= 0:
            self._lost_beside -= 1
            if self._lost_beside < 0:
                return self.overflown(notification)
        return notification

    def overflown(self, notification: Any) -> Any:
        """A notification that says that something was lost beside it."""
        return notification

    @abstractmethod
    def encode(self, notification: Any, room: int, misfit: Misfit) -> bytes:
        """A notification as bytes; a value that takes more than `room` is told by its StatusCode alone."""

    def clear(self) -> None:
        """Forget what waits."""
        account = self.owner.account
        account.release(sum(map(weight, self.queue)))
        account.leave(self)
        self.queue.clear()
        self.is_owed, self._lost_beside = False, -1


class DataItem(Item):
    """Watches one attribute of a node."""

    __slots__ = (
        "_aspace",
        "_held",
        "attribute",
        "deadband",
        "due",
        "handle",
        "index_range",
        "interval_s",
        "last",
        "source",
        "timestamps",
        "trigger",
    )

    owes = True

    def __init__(
        self,
        owner: Owner,
        item_id: int,
        request: ua.MonitoredItemCreateRequest,
        queue_size: int,
        index_range: IndexRange | None,
        timestamps: ua.TimestampsToReturn,
        aspace: AddressSpace,
        *,
        interval_s: float = 0.0,
        deadband: float = 0.0,
    ) -> None:
        super().__init__(owner, item_id, request, queue_size)
        self.attribute: AttributeIds = request.ItemToMonitor.AttributeId
        self.index_range = index_range
        self.timestamps = timestamps
        self.last: ua.DataValue | None = None
        self.handle = 0
        self.source: HeldValue | None = None
        """What holds the attribute, where it has the bytes of its value beside it."""
        self._aspace = aspace
        self.interval_s = interval_s
        """Sampling interval; 0 tells each write."""
        self.due = 0.0
        """When the next sample is due, on the monotonic clock."""
        self._held: ua.DataValue | None = None
        """The value that was written before a sample was due."""
        self.set_filter(request.RequestedParameters.Filter, deadband)

    def set_filter(self, wanted: Any, deadband: float) -> None:
        """Take a DataChangeFilter that has been checked, or None for changes of value and status."""
        trigger = ua.DataChangeTrigger.StatusValue if wanted is None else ua.DataChangeTrigger(wanted.Trigger)
        with_deadband = wanted is not None and bool(wanted.DeadbandType)
        if trigger is ua.DataChangeTrigger.StatusValueTimestamp and with_deadband:
            trigger = ua.DataChangeTrigger.StatusValue  # OPC 10000-4 7.10
        self.trigger: ua.DataChangeTrigger = trigger
        self.deadband = deadband
        """Greatest difference of numbers that is not told."""

    @property
    def holds(self) -> bool:
        """Whether a value waits until the next sample is due."""
        return self._held is not None

    def set_interval(self, interval_s: float) -> None:
        """Have another sampling interval, counted from the last sample."""
        self.due += interval_s - self.interval_s
        self.interval_s = interval_s
        if self._held is None:
            return
        if interval_s:
            self.owner.hold(self)
        else:
            held, self._held = self._held, None
            self._look_at(held)

    def changed(self, handle: int, value: ua.DataValue | None, error: ua.StatusCode | None = None) -> Done:
        """Asyncua's callback for each write to the node; with an error the node has been deleted."""
        if self.mode is _DISABLED:
            return DONE
        if value is None:
            value = ua.DataValue(StatusCode=error)
        if self.interval_s:
            self._sample(value, time.monotonic())
        elif self._is_news(value):
            self.put(value)
        return DONE

    def _sample(self, value: ua.DataValue, now: float) -> None:
        """Take a written value when a sample is due, and hold it until then otherwise."""
        if now >= self.due:
            self.sample(now)
        if now >= self.due:
            self.due = now + self.interval_s
            self._look_at(value)
            return
        was_held, self._held = self._held, value
        if was_held is None:  # known as one that holds before it is listed: the list may be made anew
            self.owner.hold(self)

    def sample(self, now: float) -> None:
        """Look at the value that was there when a sample was due, if one is."""
        if self._held is None or now < self.due:
            return
        held, self._held = self._held, None
        # The next one is an interval after this one, or now where that is over too.
        self.due += self.interval_s
        self._look_at(held)

    def _look_at(self, value: ua.DataValue) -> None:
        """Queue a value that differs from the last one."""
        if self._is_news(value):
            self.put(value)

    def _is_news(self, value: ua.DataValue) -> bool:
        """Whether a value differs from the last one; it is the last one from now on."""
        last = self.last
        if last is not None and not self._differs(last, value):
            if not self.deadband:
                self.last = value  # the same for this item, and the old one may go
            return False
        self.last = value
        return True

    def take(self) -> ua.DataValue:
        """The oldest value, out of the queue; the one that there is now, where all that waited gave way."""
        if self.queue:
            taken: ua.DataValue = super().take()
            return taken
        self.is_owed, self._lost_beside = False, -1
        return self.overflown(self._aspace.read_attribute_value(self.node_id, self.attribute))

    def encode(self, notification: ua.DataValue, room: int, misfit: Misfit) -> bytes:
        """A MonitoredItemNotification; a value that takes more than `room` is told by its StatusCode alone."""
        value = notification
        if self.index_range is not None:
            value = apply_range(value, self.index_range)
        elif self.source is not None:
            data = kept_change_bytes(self.client_handle, self.source, value, room, self.timestamps)
            if data is not None:
                return data
        value = with_timestamps(value, self.timestamps)
        return change_bytes(self.client_handle, value, room, misfit, functools.partial(shown, self.node_id))

    def _differs(self, old: ua.DataValue, new: ua.DataValue) -> bool:
        old_status, new_status = old.StatusCode, new.StatusCode
        if old_status is not new_status and _code(old_status) != _code(new_status):
            return True
        if self.trigger is _STATUS_ALONE:
            return False
        if self.trigger is _WITH_TIME and (
            old.SourceTimestamp != new.SourceTimestamp or old.SourcePicoseconds != new.SourcePicoseconds
        ):
            return True
        before, now = old.Value, new.Value
        if before is now:
            return False
        if self.index_range is not None and is_small(self.index_range, _SMALL_PART):
            before, now = apply_range(old, self.index_range).Value, apply_range(new, self.index_range).Value
        if before is None or now is None or before.VariantType != now.VariantType:
            return True
        earlier: Any = before.Value
        later: Any = now.Value
        if earlier is None or later is None:
            return not (_is_empty(earlier) and _is_empty(later))
        if not isinstance(later, _LISTS):
            if earlier == later or (earlier != earlier and later != later):  # a NaN is told once
                return False
            return not (self.deadband and _step(earlier, later) <= self.deadband)
        arrays = _ByIdentity(earlier), _ByIdentity(later)
        return _differ(*arrays) and not (self.deadband and _greatest_step(*arrays) <= self.deadband)

    def overflown(self, notification: ua.DataValue) -> ua.DataValue:
        """A value with the Overflow bit; a queue of one value has none (OPC 10000-4 5.13.1.5)."""
        if self.queue_size == 1:
            return notification
        code = _code(notification.StatusCode) | _OVERFLOW
        return dataclasses.replace(notification, StatusCode=status(code))

    def tell_again(self) -> None:
        """Tell the value as it is now, whether it changed or not."""
        if self.mode is _DISABLED:
            return
        self.last = self._held = None
        self.due = time.monotonic() + self.interval_s
        self._look_at(self._aspace.read_attribute_value(self.node_id, self.attribute))

    def clear(self) -> None:
        """Forget what waits."""
        super().clear()
        self._held = None


class EventItem(Item):
    """Watches the events of a node."""

    __slots__ = ("filter",)

    def __init__(
        self,
        owner: Owner,
        item_id: int,
        request: ua.MonitoredItemCreateRequest,
        queue_size: int,
        event_filter: EventFilter,
    ) -> None:
        super().__init__(owner, item_id, request, queue_size)
        self.filter = event_filter

    @property
    def is_behind(self) -> bool:
        """Whether so much waits for the client that what is not urgent waits as well."""
        return self.mode is _REPORTING and len(self.queue) > min(self.queue_size // 2, MOST_WAITING)

    def happened(self, event: Any) -> None:
        """An event of the node; it is queued if it passes the filter."""
        if self.mode is _DISABLED or not self.filter.passes(event):
            return
        fields = [field.of(event) for field in self.filter.select]
        self.put(ua.EventFieldList(self.client_handle, fields))  # pyright: ignore[reportArgumentType]

    def encode(self, notification: Any, room: int, misfit: Misfit) -> bytes:
        """An event's fields as bytes."""
        return event_bytes(notification, misfit, shown(self.node_id))


def with_timestamps(value: ua.DataValue, wanted: ua.TimestampsToReturn) -> ua.DataValue:
    """A DataValue with the timestamps that the client asked for."""
    if wanted == ua.TimestampsToReturn.Both:
        return value
    source = wanted == ua.TimestampsToReturn.Source
    server = wanted == ua.TimestampsToReturn.Server
    return ua.DataValue(
        value.Value,
        value.StatusCode,
        value.SourceTimestamp if source else None,
        value.ServerTimestamp if server else None,
        value.SourcePicoseconds if source else None,
        value.ServerPicoseconds if server else None,
    )


def _code(code: ua.StatusCode | None) -> int:
    return 0 if code is None else int(code.value)


def _is_empty(content: Any) -> bool:
    """Whether it is null, or what counts as that (OPC 10000-4 7.10)."""
    return content is None or (isinstance(content, str | bytes | list | tuple) and not content)


class _ByIdentity:
    """An array that is no other one, however equal.

    The items of a node have the same arrays to compare at a write: each pair is compared once, for all items.
    """

    __slots__ = ("value",)

    def __init__(self, value: Any) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ByIdentity) and other.value is self.value

    def __hash__(self) -> int:
        return id(self.value)


@functools.lru_cache(8)
def _content_bytes(content: _ByIdentity) -> int:
    return content_bytes(content.value)


@functools.lru_cache(8)
def _differ(old: _ByIdentity, new: _ByIdentity) -> bool:
    return bool(old.value != new.value)


@functools.lru_cache(8)
def _greatest_step(old: _ByIdentity, new: _ByIdentity) -> float:
    return _step(old.value, new.value)


def _step(old: Any, new: Any) -> float:
    """How far a number has moved, or that of an array which moved most; infinite where that cannot be said."""
    if isinstance(old, list | tuple) and isinstance(new, list | tuple):
        return max(map(_step, old, new), default=0.0) if len(old) == len(new) else math.inf
    if isinstance(old, int | float) and isinstance(new, int | float):
        step = abs(new - old)
        return step if step >= 0 else math.inf  # NaN compares with nothing
    return math.inf
