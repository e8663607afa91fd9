"""Feeds of nodes that come and go: they are looked up anew when the server says that something has come or gone."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Coroutine, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, aclosing, asynccontextmanager
from typing import Any, Final, Protocol, TypeVar

from ua_fleet.client import FleetClient, Reading, Told
from ua_fleet.console.board import Board
from ua_fleet.errors import UaFleetError

__all__ = ["News", "PartsDiffer", "followed", "show_rows", "telling"]

Layout = TypeVar("Layout")
_TOGETHER_S: Final = 0.05
_PARTS_DIFFER_S: Final = 5.0
"""Parts of a row that belong together and do not fit for so long are no change that is half told."""


class PartsDiffer(UaFleetError):
    """Variables of one row that belong together do not fit: one has changed, and the others are still to come."""

    remedy = "Load the page again; where that does not help, look at the server's log."


class News(Protocol):
    """Something that says when to look again."""

    async def wait(self) -> None:
        """Return when something has come or gone since the last wait; raises NotConnected."""


async def followed(
    client: FleetClient,
    look: Callable[[], Awaitable[Layout]],
    show: Callable[[Layout], Coroutine[Any, Any, None]],
    news: AbstractAsyncContextManager[News] | None = None,
) -> None:
    """Show what is there, and begin that anew whenever something else is there; never returns.

    Args:
        client: connected.
        look: which nodes are there; what two looks return is compared.
        show: keeps a board true for these nodes until it is cancelled. Raises what ends the feed.
        news: says when to look again; by default the server's GeneralModelChangeEvents.
    """
    async with news or client.model_changes() as changes:
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


@asynccontextmanager
async def telling(client: FleetClient, kinds: tuple[type[Told], ...]) -> AsyncGenerator[News]:
    """News of events: runs, decisions and faults come and go with events of theirs, and with no model change."""
    async with client.told() as told:

        class Heard:
            async def wait(self) -> None:
                async for one in told:
                    if isinstance(one, kinds):
                        await asyncio.sleep(_TOGETHER_S)
                        return

        yield Heard()


async def show_rows(
    client: FleetClient,
    board: Board,
    rows: Mapping[str, str],
    parts: Sequence[str],
    make: Callable[[str, Mapping[str, Reading]], Any],
    *,
    period_ms: float = 250.0,
) -> None:
    """Keep one value on a board for each of some Objects, made of their Variables; never returns.

    Args:
        client: connected.
        board: whose other keys go.
        rows: by key, the NodeId of the Object; its Variables have this NodeId with `.` and their names.
        parts: names of the Variables.
        make: the value of a row; None: the row is not to be seen. Where it raises PartsDiffer, the row stays as it was
            until what is still to come is there.
        period_ms: publishing interval.

    Raises:
        PartsDiffer: they did not fit for 5 s.
    """
    board.keep(set(rows))
    place = {f"{node}.{part}": (key, part) for key, node in rows.items() for part in parts}
    told: dict[str, dict[str, Reading]] = {key: {} for key in rows}
    missing = set(rows)
    if not rows:
        board.ready()
        await asyncio.Event().wait()
    differing = _Differing()
    async with differing.limit(), aclosing(client.watch(list(place), period_ms=period_ms)) as changes:
        async for reading in changes:
            key, part = place[reading.node_id]
            told[key][part] = reading
            if len(told[key]) < len(parts):
                continue
            try:
                row = make(key, told[key])
            except PartsDiffer as error:
                differing.add(key, error)
                continue
            differing.discard(key)
            if row is None:
                board.gone(key)
            else:
                board.put(key, row)
            if missing:
                missing.discard(key)
                if not missing:
                    board.ready()


class _Differing:
    """The rows whose parts do not fit now, of which the first is waited for so long and no longer."""

    def __init__(self) -> None:
        self._rows: dict[str, tuple[float, PartsDiffer]] = {}
        """By key: until when it is waited for, and what is wrong."""
        self._timeout = asyncio.timeout(None)

    @asynccontextmanager
    async def limit(self) -> AsyncGenerator[None]:
        """Raise what is wrong with a row that is not whole in time."""
        try:
            async with self._timeout:
                yield
        except TimeoutError:
            if not self._timeout.expired():
                raise
            raise next(iter(self._rows.values()))[1] from None

    def add(self, key: str, error: PartsDiffer) -> None:
        until_s, _ = self._rows.get(key, (asyncio.get_running_loop().time() + _PARTS_DIFFER_S, error))
        self._rows[key] = until_s, error
        self._reschedule()

    def discard(self, key: str) -> None:
        if self._rows.pop(key, None) is not None:
            self._reschedule()

    def _reschedule(self) -> None:
        self._timeout.reschedule(next(iter(self._rows.values()))[0] if self._rows else None)
