"""`ua-fleet browse`: the nodes below a node."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import Connection, Json, connecting
from ua_fleet.cli.output import print_json, print_line
from ua_fleet.cli.process import run

__all__ = ["EXAMPLES", "browse"]

EXAMPLES = ("ua-fleet browse -u anna", "ua-fleet browse Fleet/Robots/ned --depth 2 -u anna")


@connecting
def browse(
    connection: Connection,
    node: Annotated[str, typer.Argument(help="NodeId, UA topic, or path such as Fleet/Robots.")] = "Objects",
    depth: Annotated[int, typer.Option(help="Levels to go down.", min=1, max=20)] = 1,
    as_json: Json = False,
) -> None:
    """List the nodes below a node."""

    async def main() -> None:
        async with connected(connection) as client:
            for info in await client.browse(node, depth=depth):
                if as_json:
                    print_json(asdict(info))
                else:
                    shown = "" if info.display_name == info.browse_name else f" ({info.display_name})"
                    print_line(f"{'  ' * info.depth}{info.browse_name}{shown}  [{info.node_class}]  {info.node_id}")

    run(main())
