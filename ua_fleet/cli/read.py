"""`ua-fleet read`: values of nodes."""

from __future__ import annotations

from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message
from ua_fleet.cli.process import run
from ua_fleet.cli.readings import Full, ReadingLines, Utc, has_never_come, waiting_text
from ua_fleet.cli.screen import ColorOption, ColorWhen

__all__ = ["EXAMPLES", "Nodes", "read"]

EXAMPLES = (
    "ua-fleet read ned.battery -u anna",
    "ua-fleet read ned '*.battery' Fleet/Traffic -u anna",
    "ua-fleet read ua_1_2_1001 'ns=2;i=1002' -u anna --json",
)

Nodes = Annotated[
    list[str],
    typer.Argument(
        help="Values, Objects for all values below them, and patterns: NodeIds, UA topics, paths such as "
        "Fleet/Robots/ned/battery, names such as ned or ned.battery, and '*.battery'."
    ),
]


@connecting
def read(
    connection: ConnectionOptions,
    nodes: Nodes,
    empty: Annotated[
        bool, typer.Option("--empty", help="Also show values below Objects that have not arrived yet.")
    ] = False,
    full: Full = False,
    utc: Utc = False,
    color: ColorOption = ColorWhen.AUTO,
    as_json: Json = False,
) -> None:
    """Print the values of some nodes, with their units, their quality where it is not Good, and the source's time.

    In a pattern `*` is any part of one name, `?` one character and `**` any number of names; it begins at the robots,
    at the bridges, or at `Fleet`. Names are separated by `/` or `.`. Groups such as G00 and the folder Data may be left
    out.
    """

    async def main() -> None:
        async with connected(connection) as client:
            selected = await client.select(nodes)
            lines = await ReadingLines.of(client, selected, full=full, utc=utc, color=color, as_json=as_json)
            waiting = 0
            for node, reading in zip(selected, await client.read([one.node_id for one in selected]), strict=True):
                if node.is_named or as_json or empty or not has_never_come(reading):
                    lines.show(node.name, reading)
                else:
                    waiting += 1
            if waiting:
                message(f"{waiting_text(waiting)}; --empty shows which")

    run(main())
