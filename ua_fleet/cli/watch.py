"""`ua-fleet watch`: changes of nodes as they come."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import Connection, Json, connecting
from ua_fleet.cli.output import print_reading
from ua_fleet.cli.process import run
from ua_fleet.errors import SendTimeout

__all__ = ["EXAMPLES", "watch"]

EXAMPLES = ("ua-fleet watch ua_1_2_1001 -u anna", "ua-fleet watch ua_1_2_1001 --count 10 --timeout 30 -u anna --json")


@connecting
def watch(
    connection: Connection,
    nodes: Annotated[list[str], typer.Argument(help="NodeIds, UA topics, or paths.")],
    count: Annotated[int | None, typer.Option(help="End after so many lines.", min=1)] = None,
    timeout: Annotated[float | None, typer.Option(help="End after so many seconds.", min=0.1)] = None,
    period_ms: Annotated[float, typer.Option(help="Publishing interval in milliseconds.", min=10)] = 100.0,
    as_json: Json = False,
) -> None:
    """Print the values of some nodes, and then each change until Ctrl-C.

    With --count, exit code 5 if so many lines did not come within --timeout.
    """

    async def follow() -> None:
        async with connected(connection) as client:
            names: dict[str, str] = {
                reading.node_id: node for node, reading in zip(nodes, await client.read(nodes), strict=True)
            }
            left = count
            async with aclosing(client.watch(nodes, period_ms=period_ms)) as changes:
                async for change in changes:
                    print_reading(names.get(change.node_id, change.node_id), change, as_json=as_json)
                    if left is not None:
                        left -= 1
                        if left == 0:
                            return

    async def main() -> None:
        try:
            async with asyncio.timeout(timeout):
                await follow()
        except TimeoutError:
            if count is not None:
                raise SendTimeout(f"{count} lines did not come within {timeout} s; try a longer --timeout") from None

    run(main())
