"""`ua-fleet read`: values of nodes."""

from __future__ import annotations

from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import Connection, Json, connecting
from ua_fleet.cli.output import print_reading
from ua_fleet.cli.process import run

__all__ = ["EXAMPLES", "read"]

EXAMPLES = ("ua-fleet read ua_1_2_1001 -u anna", "ua-fleet read Fleet/Robots/ned/battery 'ns=2;i=1002' -u anna --json")


@connecting
def read(
    connection: Connection,
    nodes: Annotated[list[str], typer.Argument(help="NodeIds, UA topics, or paths such as Fleet/Robots/ned/battery.")],
    as_json: Json = False,
) -> None:
    """Print the values of some nodes, with their quality and the source's time."""

    async def main() -> None:
        async with connected(connection) as client:
            for node, reading in zip(nodes, await client.read(nodes), strict=True):
                print_reading(node, reading, as_json=as_json)

    run(main())
