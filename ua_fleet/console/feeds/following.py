"""Feeds of nodes that come and go: they are looked up anew when the server says that its nodes have changed."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

from ua_fleet.client import FleetClient

__all__ = ["followed"]

Layout = TypeVar("Layout")


async def followed(
    client: FleetClient, look: Callable[[], Awaitable[Layout]], show: Callable[[Layout], Coroutine[Any, Any, None]]
) -> None:
    """Show what is there, and begin that anew whenever something else is there; never returns.

    Args:
        client: connected.
        look: which nodes are there; what two looks return is compared.
        show: keeps a board true for these nodes until it is cancelled. Raises what ends the feed.
    """
    async with client.model_changes() as changes:
        layout = await look()
        while True:
            async with asyncio.TaskGroup() as group:
                showing = group.create_task(show(layout))
                while True:
                    await changes.wait()
                    found = await look()
                    if found != layout:
                        break
                showing.cancel()
            layout = found
