"""Subscriptions of clients: owned by one session, bounded in all that they keep (OPC 10000-4 5.14)."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateUsage=false

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterator
from datetime import UTC, datetime
from functools import partial
from typing import Any, Final

from asyncua import ua
from asyncua.server.address_space import AddressSpace
from asyncua.server.internal_server import InternalServer
from asyncua.server.subscription_service import SubscriptionService

from ua_fleet.endpoint.answers import Misfit
from ua_fleet.endpoint.backlog import Backlog
from ua_fleet.endpoint.kept_events import EventKeeper
from ua_fleet.endpoint.limits import EndpointLimits
from ua_fleet.endpoint.monitored_items import MonitoredItems
from ua_fleet.endpoint.monitoring import DataItem, Item
from ua_fleet.endpoint.notifications import changes_of, encode_message, events_of, publish_response, status_change
from ua_fleet.endpoint.queues import Queues
from ua_fleet.endpoint.sessions import PublishRequest, Session
from ua_fleet.endpoint.stack import GOOD, StatusCodes, status
from ua_fleet.endpoint.turns import TURN_S, Places
from ua_fleet.endpoint.usage import SubscriptionUsage
from ua_fleet.endpoint.users import User

__all__ = ["ClientSubscription", "SubscriptionRegistry"]

_FIRST_SEQUENCE: Final = 1


class ClientSubscription:
    """One subscription: a timer, what waits to be told, and what has been told and not acknowledged."""

    def __init__(
        self,
        session: Session,
        user: User,
        subscription_id: int,
        limits: EndpointLimits,
        aspace: AddressSpace,
        registry: SubscriptionRegistry,
    ) -> None:
        self.id = subscription_id
        self.session: Session | None = session
        self.owner = user
        self.owner_certificate = session.client_certificate
        self.account = registry.queues.account(self.holder)
        self.monitored_item_srv = MonitoredItems(aspace, lambda error: registry.failed(error, subscription_id))
        self.usage = SubscriptionUsage()
        """What its diagnostics tell."""
        self.priority = 0
        self.kept_bytes = 0
        """Bytes of the messages that can be sent again."""
        self.interval_s = 1.0
        self.lifetime_count = 3
        self.keep_alive_count = 1
        self.max_notifications = limits.notifications_per_publish
        self.enabled = True
        self._limits = limits
        self._registry = registry
        self._pending: OrderedDict[int, Item] = OrderedDict()
        self._sent: OrderedDict[int, bytes] = OrderedDict()
        self._sequence = _FIRST_SEQUENCE
        self._quiet_cycles = 0
        self._cycles_without_request = 0
        self._first = True
        self._backlog: Backlog | None = None
        """What it is told of what was before."""
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
    def next_sequence(self) -> int:
        """Sequence number of the next notification message."""
        return self._sequence

    @property
    def quiet_cycles(self) -> int:
        """Publishing intervals since it has told anything."""
        return self._quiet_cycles

    @property
    def cycles_without_request(self) -> int:
        """Publishing intervals since there was a Publish request."""
        return self._cycles_without_request

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
        self._backlog = None
        self._pending.clear()
        if task is not None and task is not asyncio.current_task():
            task.cancel()
            await asyncio.wait([task])  # and not `await task`, where its cancellation could hide that of whoever waits

    async def _run(self) -> None:
        try:
            await self._publish()
            self.tell_status(StatusCodes.BadTimeout)
        except Exception as error:  # noqa: BLE001 - counted and logged; nobody waits for this task
            self._registry.failed(error, self.id)
            with contextlib.suppress(Exception):  # what is wrong may be wrong with this, too
                self.tell_status(StatusCodes.BadInternalError)
        self._registry.forget(self)
        self._task = self._backlog = None
        self.items.remove_all()
        await self._registry.tell_end(self)

    async def _publish(self) -> None:
        """Go on until the client has left the subscription alone for its lifetime."""
        due = time.monotonic()
        while await self._cycle():
            # A late loop is not made up for: the next cycle is one interval away.
            due = max(due + self.interval_s, time.monotonic())
            self._changed.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(due - time.monotonic()):
                    await self._changed.wait()
                    due = time.monotonic()

    async def _cycle(self) -> bool:
        """One publishing interval is over; whether the subscription lives on."""
        now = time.monotonic()
        while self.items.sample(now):  # noqa: ASYNC110 - others have a turn; there is no event to wait for
            await asyncio.sleep(0)
        await self._tell_backlog()
        self._report_triggered()
        if not (self._first or self._has_news()):
            self._quiet_cycles += 1
            if self._quiet_cycles < self.keep_alive_count:
                return self._lives_on()
        # However many subscriptions of a user are due at once, others have their turn between two large answers.
        async with self._registry.answering.of(self.holder):
            while self._first or self._has_news() or self._quiet_cycles >= self.keep_alive_count:
                request = self.session.take_request(self.id) if self.session is not None else None
                if request is None:
                    return self._lives_on()
                began = time.monotonic()
                more = self.answer(request)
                if time.monotonic() - began > TURN_S:
                    await asyncio.sleep(0)
                if self._backlog is not None:
                    await self._tell_backlog()
                    more = self._has_news()
                if not more:
                    break
        return True

    @property
    def has_backlog(self) -> bool:
        """Whether it is being told by and by of what was before."""
        return self._backlog is not None

    async def tell_by_and_by(self, events: Iterator[None], item_id: int | None = None) -> None:
        """Tell events, one at most with each step, as the queues of its items, or of this one, have room for them.

        Returns as soon as clients have to fetch some first; the others follow.
        """
        self._backlog = Backlog(events, partial(self.items.are_behind, item_id))
        await self._tell_backlog()

    async def _tell_backlog(self) -> None:
        while (backlog := self._backlog) is not None:
            try:
                goes_on = backlog.tell()
            except Exception as error:  # noqa: BLE001 - counted and logged; what is new is told all the same
                self._registry.failed(error, self.id)
                goes_on = False
            if backlog.is_over:
                self._backlog = None
            if not goes_on:
                return
            await asyncio.sleep(0)

    def _lives_on(self) -> bool:
        """Count the cycles in which there was no Publish request (OPC 10000-4 5.14.1.1); False ends the lifetime."""
        if self.session is not None and self.session.has_request:
            self._cycles_without_request = 0
            return True
        self._cycles_without_request += 1
        self.usage.late += self._has_news()
        return self._cycles_without_request < self.lifetime_count

    @property
    def holder(self) -> str:
        """Whom it counts for: its owner, or the address of one without a name."""
        if not self.owner.anonymous:
            return self.owner.name
        return f"at {self.session.address if self.session is not None else ''}"

    def _has_news(self) -> bool:
        return self.enabled and bool(self._pending)

    def pending(self, item: Item) -> None:
        """An item has something to tell that it had not before."""
        self._pending[item.id] = item

    def overflown(self, item: Item) -> None:
        """A notification of an item gave way to a newer one."""
        if isinstance(item, DataItem):
            self.usage.overflows += 1
        else:
            self.usage.event_overflows += 1

    def fired(self, item: Item) -> None:
        """An item with triggering links has a notification."""
        self.items.fired(item)

    def hold(self, item: DataItem) -> None:
        """A value waits until the next sample of its item is due."""
        self.items.hold(item)

    def _report_triggered(self) -> None:
        for item in self.items.triggered():
            self.pending(item)

    def touch(self) -> None:
        """The client has used the subscription: its lifetime begins again."""
        self._cycles_without_request = 0

    def answer(self, request: PublishRequest) -> bool:
        """Answer a Publish request; whether more waits to be told."""
        self.touch()
        self.usage.publish_requests += 1
        self._quiet_cycles = 0
        self._first = False
        self._report_triggered()
        notifications = self._take() if self.enabled else []
        sequence = self._sequence
        message = encode_message(sequence, datetime.now(UTC), notifications)
        if notifications:
            self._sequence = sequence % 0xFFFF_FFFF + 1
            self._keep(sequence, message)
        more = self._has_news()
        if self.session is not None and self.session.link is not None:
            response = publish_response(self.id, message, request.results, self._sent, more=more)
            self.session.link.respond(response, request.handle, request.request_id)
        return more

    def _keep(self, sequence: int, message: bytes) -> None:
        """Keep a message until it is acknowledged, as far as there is room for its user's."""
        self._sent[sequence] = message
        self.kept_bytes += len(message)
        if len(self._sent) > self._limits.retransmissions:
            self.forget_oldest()
        self._registry.limit_kept(self.holder, self._limits.retransmission_bytes)

    def forget_oldest(self) -> None:
        """Keep one message less."""
        self.usage.discarded += 1
        self.kept_bytes -= len(self._sent.popitem(last=False)[1])

    def _take(self) -> list[bytes]:
        """As many notifications as one response may have, as DataChangeNotification and EventNotificationList."""
        left, most = self.max_notifications, self._limits.response_bytes
        room = self._limits.notification_bytes
        if self.session is not None:
            room, most = self.session.room(room), self.session.room_for_one(most)
        changes: list[bytes] = []
        events: list[bytes] = []
        while self._pending and left > 0 and room > 0:
            item_id, item = next(iter(self._pending.items()))
            target = changes if isinstance(item, DataItem) else events
            while item.waits and left > 0 and room > 0:
                # The first one that is longer than the room is told nevertheless.
                data = item.encode(item.take(), most, self._registry.misfit)
                target.append(data)
                left, room = left - 1, room - len(data)
            if not item.waits:
                del self._pending[item_id]
        notifications: list[bytes] = []
        self.usage.data_changes += len(changes)
        self.usage.events += len(events)
        if changes:
            notifications.append(changes_of(changes))
        if events:
            notifications.append(events_of(events))
        return notifications

    def tell_status(self, code: int) -> None:
        """Tell the session that the subscription has gone: now, or with its next Publish request.

        It is not kept and takes no number: a session that takes the subscription over misses nothing.
        """
        if self.session is None:
            return
        self.session.say_farewell(self.id, encode_message(self._sequence, datetime.now(UTC), [status_change(code)]))

    def acknowledge(self, sequence: int) -> int:
        """The client has a notification message; the StatusCode for it."""
        message = self._sent.pop(sequence, None)
        if message is None:
            return StatusCodes.BadSequenceNumberUnknown
        self.kept_bytes -= len(message)
        return 0

    def sent(self, sequence: int) -> bytes | None:
        """A notification message that has not been acknowledged, encoded."""
        return self._sent.get(sequence)

    def remove(self, item_id: int) -> ua.StatusCode:
        """Delete a monitored item with what it had to tell."""
        if self.items.remove(item_id) is None:
            return status(StatusCodes.BadMonitoredItemIdInvalid)
        self._pending.pop(item_id, None)
        return GOOD

    def set_mode(self, item: Item, mode: ua.MonitoringMode) -> None:
        """Have an item report, only sample, or do nothing (OPC 10000-4 5.13.1.3)."""
        before, item.mode = item.mode, mode
        if mode is ua.MonitoringMode.Disabled:
            item.clear()
        if mode is not ua.MonitoringMode.Reporting:
            self._pending.pop(item.id, None)
        elif item.waits:
            self.pending(item)
        if before is ua.MonitoringMode.Disabled and mode is not before and isinstance(item, DataItem):
            item.tell_again()

    def reporting(self) -> Iterator[DataItem]:
        """Its items that report values, but for those that are removed meanwhile."""
        for item in self.items:
            if not isinstance(item, DataItem) or self.items.get(item.id) is not item:
                continue
            if item.mode is ua.MonitoringMode.Reporting:
                yield item

    def move(self, session: Session) -> None:
        """Give the subscription to another session of its owner."""
        old = self.session
        # A client is known by its ApplicationUri.
        if old is not None and old.application == session.application:
            self.usage.transferred_to_same += 1
        else:
            self.usage.transferred_to_other += 1
        if old is not None:
            self.tell_status(StatusCodes.GoodSubscriptionTransferred)
            old.subscriptions.pop(self.id, None)
            old.late.pop(self.id, None)
            if not old.subscriptions:
                old.refuse_requests(StatusCodes.BadNoSubscription)
        self._registry.count_no_more(self)  # without a name its holder is its session's address
        self.session = session
        self._registry.count_for_holder(self)
        session.subscriptions[self.id] = self
        self.touch()


class SubscriptionRegistry(SubscriptionService):
    """asyncua's registry, which it hands events to, with the clients' subscriptions in it."""

    failed: Callable[[Exception, int], None]
    """Told of mistakes of ours, and of the subscription that they cost something."""

    def __init__(self, aspace: AddressSpace, iserver: InternalServer, misfit: Misfit, limits: EndpointLimits) -> None:
        super().__init__(aspace, iserver)
        self.misfit = misfit
        self.created: Callable[[ClientSubscription], None] | None = None
        """Told of a new subscription."""
        self.ended: Callable[[ClientSubscription], Awaitable[None]] | None = None
        """Told of a subscription that has ended."""
        self.keeper: EventKeeper | None = None
        """Keeps each event, for the history."""
        self.queues = Queues(limits.queued_bytes_per_user, limits.queued_bytes)
        self._held: dict[str, dict[int, ClientSubscription]] = {}
        """Those of each user, or address without one: looked at with each answer, and others' are many."""
        self.answering = Places()
        """Of the subscriptions of each user, one has the turn to answer."""

    def create(
        self, session: Session, user: User, limits: EndpointLimits, params: ua.CreateSubscriptionParameters
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
        subscription.priority = int(params.Priority)
        # asyncua declares its own class here and uses no more of it than ours has.
        registry: dict[int, Any] = self.subscriptions
        registry[subscription.id] = subscription
        self.count_for_holder(subscription)
        session.subscriptions[subscription.id] = subscription
        if self.created is not None:
            try:
                self.created(subscription)
            except Exception as error:  # noqa: BLE001 - counted and logged; it serves its client all the same
                self.failed(error, subscription.id)
        return subscription

    async def trigger_event(self, event: Any, subscription_id: int | None = None) -> None:
        """Keep an event that is for all, and tell it; called by asyncua, too."""
        if subscription_id is None and self.keeper is not None:
            self.keeper.keep(event)
        await super().trigger_event(event, subscription_id)

    def find(self, subscription_id: int) -> ClientSubscription | None:
        """A client's subscription, whoever owns it."""
        found: Any = self.subscriptions.get(subscription_id)
        return found if isinstance(found, ClientSubscription) else None

    def forget(self, subscription: ClientSubscription) -> None:
        """Take a subscription out of the registry and of its session."""
        self.subscriptions.pop(subscription.id, None)
        self.count_no_more(subscription)
        if (session := subscription.session) is not None:
            session.subscriptions.pop(subscription.id, None)
            session.late.pop(subscription.id, None)
            if not session.subscriptions:
                session.refuse_requests(StatusCodes.BadNoSubscription)

    def count_for_holder(self, subscription: ClientSubscription) -> None:
        """Count a subscription for its holder; before that changes, `count_no_more`."""
        self._held.setdefault(subscription.holder, {})[subscription.id] = subscription

    def count_no_more(self, subscription: ClientSubscription) -> None:
        """Count it for its holder no more."""
        held = self._held.get(subscription.holder, {})
        held.pop(subscription.id, None)
        if not held:
            self._held.pop(subscription.holder, None)

    async def delete(self, subscription: ClientSubscription) -> None:
        """End a subscription."""
        self.forget(subscription)
        await subscription.stop()
        await self.tell_end(subscription)

    async def tell_end(self, subscription: ClientSubscription) -> None:
        """A subscription has ended, and is out of the registry."""
        if self.ended is not None:
            try:
                await self.ended(subscription)
            except Exception as error:  # noqa: BLE001 - counted and logged
                self.failed(error, subscription.id)

    def audience(self, node_id: ua.NodeId, may: Callable[[User], bool]) -> list[ClientSubscription]:
        """The subscriptions that watch a node's events, of users who may be told."""
        everything: list[Any] = list(self.subscriptions.values())
        found: list[ClientSubscription] = []
        for each in everything:
            if isinstance(each, ClientSubscription) and each.items.watches(node_id):
                user = each.session.user if each.session is not None else None
                if user is not None and may(user):
                    found.append(each)
        return found

    def items_of(self, holder: str) -> int:
        """Monitored items that a user, or an address without one, has in all sessions."""
        return sum(len(each.items) for each in self._of(holder))

    def items_on(self, node_id: ua.NodeId, holder: str) -> int:
        """Those of them that watch one node."""
        return sum(each.items.on(node_id) for each in self._of(holder))

    def limit_kept(self, holder: str, most_bytes: int) -> None:
        """Forget what a user's subscriptions keep beyond so many bytes, of the one that keeps most first."""
        kept = sum(each.kept_bytes for each in self._of(holder))
        while kept > most_bytes:
            greediest = max(self._of(holder), key=lambda each: each.kept_bytes)
            kept -= greediest.kept_bytes
            greediest.forget_oldest()
            kept += greediest.kept_bytes

    def _of(self, holder: str) -> Iterator[ClientSubscription]:
        return iter(self._held.get(holder, {}).values())

    def orphans(self, user: User) -> int:
        """Subscriptions of a user that no session owns."""
        everything: list[Any] = list(self.subscriptions.values())
        return sum(
            isinstance(sub, ClientSubscription) and sub.session is None and sub.owner.name == user.name
            for sub in everything
        )
