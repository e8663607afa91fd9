"""Monitored items: what a subscription watches, and what waits to be told of it.

A value is compared with the last one that was told, and queued as it is: no copy is made. That is safe because every
write to a node, ours and a client's, brings a fresh DataValue that nobody changes afterwards; and it halves the cost of
a notification.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import dataclasses
import functools
import math
from collections import deque
from collections.abc import Generator
from typing import Any, Final, Protocol

from asyncua import ua
from asyncua.server.address_space import AddressSpace

from ua_fleet.server.endpoint.answers import Misfit, rough_bytes
from ua_fleet.server.endpoint.filters import EventFilter, deadband_of
from ua_fleet.server.endpoint.indexrange import IndexRange, apply_range
from ua_fleet.server.endpoint.notifications import change_bytes, event_bytes, event_fields
from ua_fleet.server.endpoint.stack import AttributeIds, shown, status

__all__ = ["DataItem", "EventItem", "Item", "Owner"]

_OVERFLOW: Final = 0x0480
"""InfoType DataValue and the Overflow bit of a StatusCode (OPC 10000-4 7.39.1)."""


class _Done:
    """What an awaited callback returns when its work is done already."""

    __slots__ = ()

    def __await__(self) -> Generator[None, None, None]:
        return
        yield


DONE: Final = _Done()


_WEIGHED: Final = 256
"""Bytes of a value that count as one notification more."""


def weight(notification: Any) -> int:
    """What a notification counts as, of those that may wait: large values count as many."""
    if isinstance(notification, ua.MonitoredItemNotification):
        return 1 + rough_bytes(notification.Value) // _WEIGHED
    return 1


class Owner(Protocol):
    """The subscription of an item."""

    def pending(self, item: Item) -> None:
        """An item has something to tell that it had not before."""
        ...

    queued: int
    """Weight of all that waits to be told."""

    @property
    def crowded(self) -> bool:
        """Whether so much waits that each item is to keep its newest alone."""
        ...


class Item:
    """What data and event items share: a queue of bounded length."""

    __slots__ = ("client_handle", "discard_oldest", "id", "mode", "node_id", "owner", "queue", "queue_size")

    def __init__(self, owner: Owner, item_id: int, request: ua.MonitoredItemCreateRequest, queue_size: int) -> None:
        self.owner = owner
        self.id = item_id
        self.node_id: ua.NodeId = request.ItemToMonitor.NodeId
        self.mode: ua.MonitoringMode = request.MonitoringMode
        self.client_handle: int = request.RequestedParameters.ClientHandle
        self.discard_oldest: bool = bool(request.RequestedParameters.DiscardOldest)
        self.queue_size = queue_size
        self.queue: deque[Any] = deque()

    def put(self, notification: Any) -> None:
        """Queue a notification; a full queue loses its oldest, or keeps it and loses the newest before this one."""
        queue, owner = self.queue, self.owner
        if not queue:
            self._append(notification)
            owner.pending(self)
            return
        if len(queue) < self.queue_size and not owner.crowded:
            self._append(notification)
            return
        owner.queued -= weight(queue.popleft() if self.discard_oldest else queue.pop())
        self._append(notification)
        if self.queue_size > 1:
            self.mark_overflow(0 if self.discard_oldest else -1)

    def _append(self, notification: Any) -> None:
        self.queue.append(notification)
        self.owner.queued += weight(notification)

    def take(self) -> Any:
        """The oldest notification, out of the queue."""
        notification = self.queue.popleft()
        self.owner.queued -= weight(notification)
        return notification

    def mark_overflow(self, at: int) -> None:
        """Say at a place of the queue that something was lost there."""

    def encode(self, notification: Any, room: int, misfit: Misfit) -> bytes:
        """A notification as bytes; a value that takes more than `room` is told by its StatusCode alone."""
        return change_bytes(notification, room, misfit, shown(self.node_id))

    def clear(self) -> None:
        """Forget what waits."""
        self.owner.queued -= sum(map(weight, self.queue))
        self.queue.clear()


class DataItem(Item):
    """Watches one attribute of a node."""

    __slots__ = ("attribute", "deadband", "handle", "index_range", "last", "timestamps", "trigger")

    def __init__(
        self,
        owner: Owner,
        item_id: int,
        request: ua.MonitoredItemCreateRequest,
        queue_size: int,
        index_range: IndexRange | None,
        timestamps: ua.TimestampsToReturn,
    ) -> None:
        super().__init__(owner, item_id, request, queue_size)
        self.attribute: AttributeIds = request.ItemToMonitor.AttributeId
        self.index_range = index_range
        self.timestamps = timestamps
        self.last: ua.DataValue | None = None
        self.handle = 0
        self.set_filter(request.RequestedParameters.Filter)

    def set_filter(self, wanted: Any) -> None:
        """Take a DataChangeFilter that has been checked, or None for changes of value and status."""
        trigger = ua.DataChangeTrigger.StatusValue if wanted is None else ua.DataChangeTrigger(wanted.Trigger)
        self.trigger: ua.DataChangeTrigger = trigger
        self.deadband: float = 0.0 if wanted is None else deadband_of(wanted)

    def changed(self, handle: int, value: ua.DataValue | None, error: ua.StatusCode | None = None) -> _Done:
        """Asyncua's callback for each write to the node; with an error the node has been deleted."""
        if self.mode is ua.MonitoringMode.Disabled:
            return DONE
        if value is None:
            value = ua.DataValue(StatusCode=error)
        if self.index_range is not None:
            value = apply_range(value, self.index_range)
        last = self.last
        if last is not None and not self._differs(last, value):
            return DONE
        self.last = value
        if self.mode is ua.MonitoringMode.Reporting:
            told = value if self.timestamps is ua.TimestampsToReturn.Both else with_timestamps(value, self.timestamps)
            self.put(ua.MonitoredItemNotification(self.client_handle, told))  # pyright: ignore[reportArgumentType]
        return DONE

    def _differs(self, old: ua.DataValue, new: ua.DataValue) -> bool:
        old_status, new_status = old.StatusCode, new.StatusCode
        if old_status is not new_status and _code(old_status) != _code(new_status):
            return True
        if self.trigger is ua.DataChangeTrigger.Status:
            return False
        if self.trigger is ua.DataChangeTrigger.StatusValueTimestamp and (
            old.SourceTimestamp != new.SourceTimestamp or old.SourcePicoseconds != new.SourcePicoseconds
        ):
            return True
        before, now = old.Value, new.Value
        if before is now:
            return False
        if before is None or now is None or before.VariantType != now.VariantType:
            return True
        earlier: Any = before.Value
        later: Any = now.Value
        if not isinstance(later, list | tuple):
            return earlier != later and not (self.deadband and _step(earlier, later) <= self.deadband)
        arrays = _ByIdentity(earlier), _ByIdentity(later)
        return _differ(*arrays) and not (self.deadband and _greatest_step(*arrays) <= self.deadband)

    def mark_overflow(self, at: int) -> None:
        """Set the Overflow bit of a queued value."""
        notification = self.queue[at]
        value = notification.Value
        marked = dataclasses.replace(value, StatusCode=status(_code(value.StatusCode) | _OVERFLOW))
        self.queue[at] = ua.MonitoredItemNotification(self.client_handle, marked)  # pyright: ignore[reportArgumentType]

    def tell_again(self, aspace: AddressSpace) -> None:
        """Tell the value as it is now, whether it changed or not."""
        self.last = None
        self.changed(self.handle, aspace.read_attribute_value(self.node_id, self.attribute))


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

    def happened(self, event: Any) -> None:
        """An event of the node; it is queued if it passes the filter."""
        if self.mode is not ua.MonitoringMode.Reporting or not self.filter.passes(event):
            return
        fields = event_fields(event, self.filter.select)
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
