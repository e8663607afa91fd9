"""`ua-fleet status`: how a fleet stands, on one screen."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.endings import EXIT_FAILED
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import print_json, write_line
from ua_fleet.cli.process import run
from ua_fleet.cli.readings import Utc, zone_of
from ua_fleet.cli.screen import ColorOption, ColorWhen, has_colours, live_screen, terminal_width

__all__ = ["EXAMPLES", "status"]

EXAMPLES = (
    "ua-fleet status -u anna",
    "ua-fleet status --watch -u anna",
    "ua-fleet status --json -u anna",
)


@connecting
def status(
    connection: ConnectionOptions,
    watch: Annotated[bool, typer.Option("--watch", help="Show it again and again, until Ctrl-C.")] = False,
    every: Annotated[float, typer.Option(help="Seconds between two looks with --watch.", min=0.2)] = 2.0,
    whole: Annotated[
        bool, typer.Option("--all", help="List all robots of a large fleet, and read all their values.")
    ] = False,
    utc: Utc = False,
    color: ColorOption = ColorWhen.AUTO,
    as_json: Json = False,
) -> None:
    """Show how the fleet stands: server, bridges, robots, faults with what ends them, runs, and what was dropped.

    Exit code 0 if nothing is wrong, 1 if something is: the server does not run or its certificate expires within 30
    days, a bridge is not heard or not connected, a robot is offline or faulted, a fault is active, or a decision waits
    for a person. 4 if the server cannot be reached. Drops and qualities are shown and do not count: they may be those
    of an hour ago.
    """

    async def look(show: Callable[[Sequence[str]], None]) -> bool:
        from ua_fleet.cli.status_text import problems_of, status_json, status_lines
        from ua_fleet.client import fleet_status

        async with connected(connection) as client:
            while True:
                found = await fleet_status(client, all_values=whole)
                now = datetime.now(UTC)
                problems = problems_of(found, now)
                if as_json:
                    print_json(status_json(found, problems))
                else:
                    show(
                        status_lines(
                            found,
                            now,
                            width=terminal_width(),
                            colours=has_colours(color),
                            zone=zone_of(utc),
                            all_robots=whole,
                        )
                    )
                if not watch:
                    return bool(problems)
                await asyncio.sleep(every)

    is_wrong = False

    async def main() -> None:
        nonlocal is_wrong
        if watch and not as_json:
            with live_screen() as screen:
                is_wrong = await look(screen.show)
        else:
            is_wrong = await look(_print)

    run(main())
    if is_wrong:
        raise typer.Exit(EXIT_FAILED)


def _print(lines: Sequence[str]) -> None:
    for line in lines:
        write_line(line)
