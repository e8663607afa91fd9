"""`ua-fleet watch`: changes of nodes as they come."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Coroutine, Sequence
from contextlib import aclosing
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated, Final

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run
from ua_fleet.cli.read import Nodes
from ua_fleet.cli.readings import Full, ReadingLines, Utc, has_never_come, waiting_text
from ua_fleet.cli.screen import ColorOption, ColorWhen, live_screen, terminal_width
from ua_fleet.cli.table import table_lines
from ua_fleet.cli.watched import Watched
from ua_fleet.errors import SendTimeout

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient, Reading, SelectedNode

__all__ = ["EXAMPLES", "watch"]

EXAMPLES = (
    "ua-fleet watch ned.battery -u anna",
    "ua-fleet watch ned '*.battery' --table --rate --age -u anna",
    "ua-fleet watch 'ned.*' --rate -u anna",
    "ua-fleet watch ua_1_2_1001 --count 10 --timeout 30 -u anna --json",
)

PICTURE_S: Final = 0.5
"""Between two pictures of a table."""
RATES_S: Final = 1.0


@connecting
def watch(
    connection: ConnectionOptions,
    nodes: Nodes,
    table: Annotated[bool, typer.Option("--table", help="Show a table that is kept up to date.")] = False,
    rate: Annotated[
        bool, typer.Option("--rate", help="Show values per second, in place of the values or as a column of the table.")
    ] = False,
    age: Annotated[bool, typer.Option("--age", help="Show the age of each value by this machine's clock.")] = False,
    count: Annotated[int | None, typer.Option(help="End after this number of values.", min=1)] = None,
    timeout: Annotated[float | None, typer.Option(help="End after this number of seconds.", min=0.1)] = None,
    period_ms: Annotated[float, typer.Option(help="Publishing interval in milliseconds.", min=10)] = 100.0,
    full: Full = False,
    utc: Utc = False,
    color: ColorOption = ColorWhen.AUTO,
    as_json: Json = False,
) -> None:
    """Print the values of some nodes, and then each change until Ctrl-C.

    Nodes are given as for `read`. --rate does not count the values that are printed first. With --count, the exit code
    is 5 if fewer values come within --timeout.
    """
    if table and as_json:
        raise UsageError("--table is for people and --json for programs; leave one of them out")
    wanted = _Wanted(table, rate, age, count, period_ms)

    async def main() -> None:
        is_connected = False
        try:
            async with asyncio.timeout(timeout), connected(connection) as client:
                is_connected = True
                selected = list({one.node_id: one for one in await client.select(nodes)}.values())
                lines = await ReadingLines.of(client, selected, full=full, utc=utc, color=color, as_json=as_json)
                await _follow(client, selected, lines, wanted)
        except TimeoutError:
            if not is_connected:
                raise SendTimeout(f"{connection.endpoint} did not answer in time") from None
            if count is not None:
                raise SendTimeout(f"{count} values did not come within {timeout} s; try a longer --timeout") from None

    run(main())


@dataclass(frozen=True, slots=True)
class _Wanted:
    """What the options say."""

    table: bool
    rate: bool
    age: bool
    count: int | None
    period_ms: float


async def _follow(client: FleetClient, nodes: Sequence[SelectedNode], lines: ReadingLines, wanted: _Wanted) -> None:
    watched = Watched(nodes, lines.styles, now=time.monotonic())
    expected = {node.node_id for node in nodes if not node.is_named and not lines.as_json}
    """What is below Objects, and is shown from its first value on."""

    def is_shown(change: Reading) -> bool:
        return change.node_id not in expected or not has_never_come(change)

    def take(change: Reading) -> bool:
        watched.take(change, time.monotonic())
        return is_shown(change)

    if wanted.table:
        with live_screen() as screen:

            def draw() -> None:
                rows, waiting = watched.rows(
                    time.monotonic(), datetime.now(UTC), lines.zone, with_rate=wanted.rate, with_age=wanted.age
                )
                picture = table_lines(rows, width=terminal_width(), colours=lines.colours)
                screen.show([*picture, waiting_text(waiting)] if waiting else picture)

            await _with_pictures(_each(client, nodes, wanted, take), PICTURE_S, draw)
    elif wanted.rate:
        await _with_pictures(_each(client, nodes, wanted, take), RATES_S, lambda: _print_rates(watched, lines.as_json))
    else:
        names = {node.node_id: node.name for node in nodes}

        def show(change: Reading) -> bool:
            if is_shown(change):
                lines.show(names[change.node_id], change, arrived=datetime.now(UTC) if wanted.age else None)
            return is_shown(change)

        await _each(client, nodes, wanted, show)


async def _each(
    client: FleetClient, nodes: Sequence[SelectedNode], wanted: _Wanted, take: Callable[[Reading], bool]
) -> None:
    """Hand over each value, until as many as wanted were taken for one that is shown."""
    left = math.inf if wanted.count is None else wanted.count
    # Whether a value is new is told by its time, and not only by what it is.
    changes = client.watch(
        [one.node_id for one in nodes], period_ms=wanted.period_ms, with_times=wanted.table or wanted.rate
    )
    try:
        async with aclosing(changes):
            async for change in changes:
                left -= take(change)
                if left == 0:
                    return
    finally:
        if client.dropped:
            message(f"{client.dropped} values were dropped: they came faster than they could be shown")


async def _with_pictures(work: Coroutine[None, None, None], period_s: float, draw: Callable[[], None]) -> None:
    """Draw what there is now and then, while something is under way, and at its end; raises what either does."""

    async def pictures() -> None:
        while True:
            await asyncio.sleep(period_s)
            draw()

    drawing, working = asyncio.ensure_future(pictures()), asyncio.ensure_future(work)
    try:
        await asyncio.wait([drawing, working], return_when=asyncio.FIRST_COMPLETED)
        if drawing.done():
            drawing.result()  # nobody reads stdout any more
        working.result()
        draw()
    finally:
        drawing.cancel()
        working.cancel()
        await asyncio.gather(drawing, working, return_exceptions=True)


def _print_rates(watched: Watched, as_json: bool) -> None:
    for node, per_s, total in watched.rates(time.monotonic()):
        if as_json:
            print_json({"node": node.name, "node_id": node.node_id, "per_s": round(per_s, 3), "count": total})
        else:
            print_line(f"{node.name}  {per_s:.1f} values/s, {total} in all")
