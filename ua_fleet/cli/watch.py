"""`ua-fleet watch`: changes of nodes as they come."""

from __future__ import annotations

import asyncio
from contextlib import aclosing
from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import DEFAULT_ENDPOINT, Endpoint, Insecure, Json, PasswordFile, Timeout, User
from ua_fleet.cli.output import print_reading
from ua_fleet.errors import SendTimeout

__all__ = ["watch"]


def watch(
    nodes: Annotated[list[str], typer.Argument(help="NodeIds, UA topics, or paths.")],
    count: Annotated[int | None, typer.Option(help="End after so many changes.", min=1)] = None,
    seconds: Annotated[float | None, typer.Option(help="End after so many seconds.", min=0.1)] = None,
    period_ms: Annotated[float, typer.Option(help="Publishing interval in milliseconds.", min=10)] = 100.0,
    endpoint: Endpoint = DEFAULT_ENDPOINT,
    user: User = None,
    password_file: PasswordFile = None,
    insecure: Insecure = False,
    timeout: Timeout = 10.0,
    as_json: Json = False,
) -> None:
    """Print the values of some nodes, and then each change until Ctrl-C.

    With --count, exit code 5 if the changes did not come within --seconds.
    """

    async def follow() -> None:
        async with connected(endpoint, user, password_file, insecure=insecure, timeout_s=timeout) as client:
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

    async def run() -> None:
        try:
            async with asyncio.timeout(seconds):
                await follow()
        except TimeoutError:
            if count is not None:
                raise SendTimeout(f"{count} changes did not come within {seconds} s") from None

    asyncio.run(run())
