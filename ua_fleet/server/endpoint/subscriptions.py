"""Subscriptions of clients: owned by one session, bounded in all that they keep (OPC 10000-4 5.14)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict
from datetime import UTC, datetime
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.subscription_service import SubscriptionService

from ua_fleet.server.endpoint.limits import Limits
from ua_fleet.server.endpoint.monitoring import DataItem, EventItem, Item
from ua_fleet.server.endpoint.sessions import PublishRequest, Session
from ua_fleet.server.endpoint.stack import GOOD, StatusCodes, status
from ua_fleet.server.users import User

__all__ = ["ClientSubscription", "MonitoredItems", "Subscriptions"]

_FIRST_SEQUENCE: Final = 1
_log = structlog.get_logger("ua_fleet.server")


class MonitoredItems:
    """The items of one subscription; asyncua gives it the events."""

    def __init__(self, aspace: AddressSpace) -> None:
        self._aspace = aspace
        self._monitored_items: dict[int, Item] = {}
        self._by_node: dict[ua.NodeId, dict[int, EventItem]] = {}
        self._last_id = 0

    def __len__(self) -> int:
        return len(self._monitored_items)

    def __iter__(self) -> Any:
        return iter(list(self._monitored_items.values()))

    def get(self, item_id: int) -> Item | None:
        """An item by its id."""
        return self._monitored_items.get(item_id)

    def next_id(self) -> int:
        """The id of the next item."""
        self._last_id += 1
        return self._last_id

    def add_data(self, item: DataItem) -> ua.StatusCode:
        """Watch a node's attribute, and tell its value as it is now."""
        result, item.handle = self._aspace.add_datachange_callback(item.node_id, item.attribute, item.changed)
        if result.is_good():
            self._monitored_items[item.id] = item
            item.tell_again(self._aspace)
        return result

    def add_events(self, item: EventItem) -> None:
        """Watch the events of a node."""
        self._monitored_items[item.id] = item
        self._by_node.setdefault(item.node_id, {})[item.id] = item

    def remove(self, item_id: int) -> Item | None:
        """Stop watching."""
        item = self._monitored_items.pop(item_id, None)
        if isinstance(item, DataItem):
            # The node, and the callback with it, may have been deleted.
            with contextlib.suppress(KeyError):
                self._aspace.delete_datachange_callback(item.handle)
        elif isinstance(item, EventItem):
            others = self._by_node[item.node_id]
            del others[item_id]
            if not others:
                del self._by_node[item.node_id]
        return item

    def remove_all(self) -> None:
        """Stop watching everything."""
        for item_id in list(self._monitored_items):
            self.remove(item_id)

    async def trigger_event(self, event: Any, mid: int | None = None) -> bool:
        """Tell the items of the event's node; called by asyncua."""
        items = self._by_node.get(event.emitting_node)
        for item in list(items.values()) if items else []:
            if mid is None or item.id == mid:
                item.happened(event)
        return bool(items)


class ClientSubscription:
    """One subscription: a timer, what waits to be told, and what has been told and not acknowledged."""

    def __init__(
        self,
        session: Session,
        user: User,
        subscription_id: int,
        limits: Limits,
        aspace: AddressSpace,
        registry: Subscriptions,
    ) -> None:
        self.id = subscription_id
        self.session: Session | None = session
        self.owner = user
        self.owner_certificate = session.client_certificate
        self.monitored_item_srv = MonitoredItems(aspace)
        self.queued = 0
        self.interval_s = 1.0
        self.lifetime_count = 3
        self.keep_alive_count = 1
        self.max_notifications = limits.notifications_per_publish
        self.enabled = True
        self._limits = limits
        self._registry = registry
        self._pending: OrderedDict[int, Item] = OrderedDict()
        self._sent: OrderedDict[int, ua.NotificationMessage] = OrderedDict()
        self._sequence = _FIRST_SEQUENCE
        self._quiet_cycles = 0
        self._cycles_without_request = 0
        self._first = True
        self._changed = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    @property
    def session_id(self) -> ua.NodeId | None:
        """Id of the session that owns it, for asyncua."""
        return self.session.session_id if self.session is not None else None

    @property
    def items(self) -> MonitoredItems:
        """Its monitored items."""
        return self.monitored_item_srv

    @property
    def crowded(self) -> bool:
        """Whether so much waits that each item is to keep its newest alone."""
        return self.queued >= self._limits.queued_notifications

    @property
    def unacknowledged(self) -> list[int]:
        """Sequence numbers that can be sent again."""
        return list(self._sent)

    def revise(self, interval_ms: float, lifetime: int, keep_alive: int, notifications: int) -> None:
        """Take the client's wishes within the limits (OPC 10000-4 5.14.2)."""
        least, most = self._limits.publishing_interval_ms
        self.interval_s = min(max(interval_ms if interval_ms == interval_ms else least, least), most) / 1000
        longest = max(3, int(self._limits.subscription_lifetime_s / self.interval_s))
        self.keep_alive_count = min(max(keep_alive or 10, 1), longest // 3)
        self.lifetime_count = min(max(lifetime, 3 * self.keep_alive_count), longest)
        cap = self._limits.notifications_per_publish
        self.max_notifications = min(notifications or cap, cap)
        self._changed.set()

    def start(self) -> None:
        """Begin to publish."""
        self._task = asyncio.create_task(self._run(), name=f"subscription {self.id}")

    async def stop(self) -> None:
        """End; nothing of it is left."""
        task, self._task = self._task, None
        self.items.remove_all()
        self._pending.clear()
        if task is not None and task is not asyncio.current_task():
            task.cancel()
            await asyncio.wait([task])  # and not `await task`, where its cancellation could hide that of whoever waits

    async def _run(self) -> None:
        try:
            await self._publish()
        except Exception:  # noqa: BLE001 - logged with its traceback; nobody waits for this task
            _log.exception("subscription failed", subscription=self.id)
            with contextlib.suppress(Exception):  # what is wrong may be wrong with this, too
                self.tell_status(StatusCodes.BadInternalError)
        self._registry.forget(self)
        self._task = None
        self.items.remove_all()

    async def _publish(self) -> None:
        """Go on until the client has left the subscription alone for its lifetime."""
        due = time.monotonic()
        while self._cycle():
            # A late loop is not made up for: the next cycle is one interval away.
            due = max(due + self.interval_s, time.monotonic())
            self._changed.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(due - time.monotonic()):
                    await self._changed.wait()
                    due = time.monotonic()

    def _cycle(self) -> bool:
        """One publishing interval is over; whether the subscription lives on."""
        if not (self._first or self._has_news()):
            self._quiet_cycles += 1
            if self._quiet_cycles < self.keep_alive_count:
                return True
        while self._first or self._has_news() or self._quiet_cycles >= self.keep_alive_count:
            request = self.session.take_request(self.id) if self.session is not None else None
            if request is None:
                self._cycles_without_request += 1
                return self._cycles_without_request < self.lifetime_count
            if not self.answer(request):
                break
        return True

    def _has_news(self) -> bool:
        return self.enabled and bool(self._pending)

    def pending(self, item: Item) -> None:
        """An item has something to tell that it had not before."""
        self._pending[item.id] = item

    def touch(self) -> None:
        """The client has used the subscription: its lifetime begins again."""
        self._cycles_without_request = 0

    def answer(self, request: PublishRequest) -> bool:
        """Answer a Publish request; whether more waits to be told."""
        self.touch()
        self._quiet_cycles = 0
        self._first = False
        message = ua.NotificationMessage()
        message.PublishTime = datetime.now(UTC)
        message.NotificationData = self._take() if self.enabled else []
        message.SequenceNumber = self._sequence  # pyright: ignore[reportAttributeAccessIssue]
        more = self._has_news()
        self._send(request, message, more)
        return more

    def _send(self, request: PublishRequest, message: ua.NotificationMessage, more: bool) -> None:
        if message.NotificationData:
            self._sequence = self._sequence % 0xFFFF_FFFF + 1
            self._sent[int(message.SequenceNumber)] = message
            while len(self._sent) > self._limits.retransmissions:
                self._sent.popitem(last=False)
        result: Any = ua.PublishResult()
        result.SubscriptionId = self.id
        result.AvailableSequenceNumbers = self.unacknowledged
        result.MoreNotifications = more
        result.NotificationMessage = message
        result.Results = request.results
        response = ua.PublishResponse()
        response.Parameters = result
        if self.session is not None and self.session.link is not None:
            self.session.link.respond(response, request.handle, request.request_id)

    def _take(self) -> list[Any]:
        """As many notifications as one response may have, as DataChangeNotification and EventNotificationList."""
        left = self.max_notifications
        changes: list[Any] = []
        events: list[Any] = []
        while self._pending and left > 0:
            item_id, item = next(iter(self._pending.items()))
            target = changes if isinstance(item, DataItem) else events
            if len(item.queue) <= left:
                del self._pending[item_id]
                target.extend(item.queue)
                left -= len(item.queue)
                item.clear()
            else:
                target.extend(item.queue.popleft() for _ in range(left))
                self.queued -= left
                left = 0
        notifications: list[Any] = []
        if changes:
            notifications.append(ua.DataChangeNotification(MonitoredItems=changes))
        if events:
            notifications.append(ua.EventNotificationList(Events=events))
        return notifications

    def tell_status(self, code: int) -> None:
        """Tell the client at once that the subscription has changed, if a request waits."""
        if self.session is None or (request := self.session.take_request(self.id)) is None:
            return
        message = ua.NotificationMessage()
        message.PublishTime = datetime.now(UTC)
        message.SequenceNumber = self._sequence  # pyright: ignore[reportAttributeAccessIssue]
        message.NotificationData = [ua.StatusChangeNotification(Status=status(code))]
        self._send(request, message, more=False)

    def acknowledge(self, sequence: int) -> ua.StatusCode:
        """The client has a notification message."""
        known = self._sent.pop(sequence, None) is not None
        return GOOD if known else status(StatusCodes.BadSequenceNumberUnknown)

    def sent(self, sequence: int) -> ua.NotificationMessage | None:
        """A notification message that has not been acknowledged."""
        return self._sent.get(sequence)

    def remove(self, item_id: int) -> ua.StatusCode:
        """Delete a monitored item with what it had to tell."""
        item = self.items.remove(item_id)
        if item is None:
            return status(StatusCodes.BadMonitoredItemIdInvalid)
        item.clear()
        self._pending.pop(item_id, None)
        return GOOD

    def silence(self, item: Item) -> None:
        """Forget what an item had to tell."""
        item.clear()
        self._pending.pop(item.id, None)

    def move(self, session: Session) -> None:
        """Give the subscription to another session of its owner."""
        old = self.session
        if old is not None:
            self.tell_status(StatusCodes.GoodSubscriptionTransferred)
            old.subscriptions.pop(self.id, None)
            old.late.pop(self.id, None)
        self.session = session
        session.subscriptions[self.id] = self
        self.touch()


class Subscriptions(SubscriptionService):
    """asyncua's registry, which it hands events to, with the clients' subscriptions in it."""

    def create(
        self, session: Session, user: User, limits: Limits, params: ua.CreateSubscriptionParameters
    ) -> ClientSubscription:
        """A new subscription of a session, not started."""
        self._sub_id_counter += 1
        subscription = ClientSubscription(session, user, self._sub_id_counter, limits, self.aspace, self)
        subscription.revise(
            params.RequestedPublishingInterval,
            params.RequestedLifetimeCount,
            params.RequestedMaxKeepAliveCount,
            params.MaxNotificationsPerPublish,
        )
        subscription.enabled = bool(params.PublishingEnabled)
        # asyncua declares its own class here and uses no more of it than ours has.
        registry: dict[int, Any] = self.subscriptions
        registry[subscription.id] = subscription
        session.subscriptions[subscription.id] = subscription
        return subscription

    def find(self, subscription_id: int) -> ClientSubscription | None:
        """A client's subscription, whoever owns it."""
        found: Any = self.subscriptions.get(subscription_id)
        return found if isinstance(found, ClientSubscription) else None

    def forget(self, subscription: ClientSubscription) -> None:
        """Take a subscription out of the registry and of its session."""
        self.subscriptions.pop(subscription.id, None)
        if subscription.session is not None:
            subscription.session.subscriptions.pop(subscription.id, None)
            subscription.session.late.pop(subscription.id, None)

    async def delete(self, subscription: ClientSubscription) -> None:
        """End a subscription."""
        self.forget(subscription)
        await subscription.stop()

    def orphans(self, user: User) -> int:
        """Subscriptions of a user that no session owns."""
        everything: list[Any] = list(self.subscriptions.values())
        return sum(
            isinstance(sub, ClientSubscription) and sub.session is None and sub.owner.name == user.name
            for sub in everything
        )
