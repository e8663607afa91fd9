# asyncua is typed in part only.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
# pyright: reportPrivateImportUsage=false, reportPrivateUsage=false
"""Subscriptions that leave nothing behind, and what they bring, for whoever iterates."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any, Generic, TypeVar

from asyncua import Client, ua
from asyncua.common.subscription import Subscription, SubscriptionHandler

from ua_fleet.client.translated import quietly, translated

__all__ = ["Begin", "Feed", "Subscriptions", "subscribe"]

Item = TypeVar("Item")
Begin = Callable[[Subscription], Awaitable[object]]
"""Says what a new subscription is to bring."""


class Feed(Generic[Item]):
    """The handler of a subscription: keeps what it brings until it is taken, as far as there is room."""

    def __init__(self, size: int) -> None:
        self._queue: asyncio.Queue[Item | None] = asyncio.Queue(size)
        self._is_lost = False
        self.dropped = 0
        """What nobody took in time."""

    async def next(self) -> Item | None:
        """The next one; None after the end of the subscription. The wait may be cancelled."""
        return await self._queue.get()

    def put(self, item: Item) -> None:
        """Hand over an item; the oldest goes where there is no room. After the end nothing comes any more."""
        if not self._is_lost:
            self._put(item)

    def _put(self, item: Item | None) -> None:
        if self._queue.full():
            self._queue.get_nowait()
            self.dropped += 1
        self._queue.put_nowait(item)

    def status_change_notification(self, status: ua.StatusChangeNotification) -> None:
        """Called by asyncua when the server ends the subscription."""
        self.lose()

    def lose(self) -> None:
        """No more will come."""
        self._is_lost = True
        self._put(None)


class Subscriptions:
    """The subscriptions of a connection that last as long as a context."""

    def __init__(self, client: Client, endpoint: str) -> None:
        self._client, self._endpoint = client, endpoint
        self._feeds: set[Feed[Any]] = set()
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """What all of them have dropped, those that have ended too."""
        return self._dropped + sum(feed.dropped for feed in self._feeds)

    def lose(self) -> None:
        """The connection is gone."""
        for feed in self._feeds:
            feed.lose()

    @asynccontextmanager
    async def open(self, feed: Feed[Any], period_ms: float, begin: Begin) -> AsyncGenerator[None]:
        """Fill a feed until the context is left; raises what `begin` does, and our errors for asyncua's."""
        self._feeds.add(feed)
        try:
            with translated(self._endpoint):
                subscription = await subscribe(self._client, feed, period_ms, begin)
            try:
                yield
            finally:
                await quietly(_delete(self._client, subscription))
        finally:
            self._feeds.discard(feed)
            self._dropped += feed.dropped


async def subscribe(client: Client, handler: SubscriptionHandler, period_ms: float, begin: Begin) -> Subscription:
    """A subscription that has begun; none is left in the server where that fails or is cancelled."""
    making = asyncio.ensure_future(_make(client, handler, period_ms, begin))
    try:
        return await asyncio.shield(making)
    except asyncio.CancelledError:
        # The server makes it though nobody waits for the answer, which alone says what is to be deleted.
        await asyncio.wait([making])
        if not making.cancelled() and making.exception() is None:
            await quietly(_delete(client, making.result()))
        raise


async def _make(client: Client, handler: SubscriptionHandler, period_ms: float, begin: Begin) -> Subscription:
    subscription = await client.create_subscription(period_ms, handler)
    try:
        # At once: asked for before the first Publish, the values that are there come with its answer.
        await begin(subscription)
    except BaseException:
        await quietly(_delete(client, subscription))
        raise
    return subscription


async def _delete(client: Client, subscription: Subscription) -> None:
    """End it, and let go of its handler with what waits there, and of its nodes, also where the server does not answer.

    asyncua keeps each subscription for a reconnection that is not used here, and its publish loop the last that it
    served. None of what is emptied here has an accessor.
    """
    try:
        await subscription.delete()
    finally:
        with suppress(ValueError):
            client._subscriptions.remove(subscription)  # noqa: SLF001
        if subscription.subscription_id is not None:  # there until the server has confirmed the end
            client.uaclient.session._subscription_callbacks.pop(subscription.subscription_id, None)  # noqa: SLF001
        subscription._handler = None  # noqa: SLF001
        subscription._monitored_items.clear()  # noqa: SLF001
