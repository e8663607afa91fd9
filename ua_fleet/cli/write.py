"""`ua-fleet write`: a value to a node."""

from __future__ import annotations

from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.process import run
from ua_fleet.cli.readings import ReadingLines

__all__ = ["EXAMPLES", "write"]

EXAMPLES = ("ua-fleet write ua_0_2_1006 0.25 -u anna", "ua-fleet write -u anna -- ua_0_2_1006 -0.25")


@connecting
def write(
    connection: ConnectionOptions,
    node: Annotated[str, typer.Argument(help="NodeId, UA topic, or path.")],
    value: Annotated[str, typer.Argument(help="Value in the node's own type; an array as JSON, e.g. '[1, 2]'.")],
    as_json: Json = False,
) -> None:
    """Write a value to a node that clients may write, and print what the node holds then.

    The server sends it to the robots over PubSub. A negative number needs `--` before the node.
    """

    async def main() -> None:
        async with connected(connection) as client:
            reading = await client.write(node, value)
            selected = await client.select([reading.node_id])
            (await ReadingLines.of(client, selected, as_json=as_json)).show(node, reading)

    run(main())
