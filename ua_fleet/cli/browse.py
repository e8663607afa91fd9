"""`ua-fleet browse`: the nodes below a node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import ConnectionOptions, Json, connecting
from ua_fleet.cli.output import message, print_json, write_line
from ua_fleet.cli.process import run
from ua_fleet.cli.readings import Full, Utc, status_cell, styles_of, zone_of
from ua_fleet.cli.screen import ColorOption, ColorWhen, has_colours
from ua_fleet.cli.tree import left_out_text, tree_lines
from ua_fleet.cli.value_text import ValueStyle, value_text

if TYPE_CHECKING:
    from ua_fleet.client import FleetClient, NodeInfo, Reading

__all__ = ["EXAMPLES", "browse"]

EXAMPLES = (
    "ua-fleet browse -u anna",
    "ua-fleet browse ned --depth 3 --values -u anna",
    "ua-fleet browse Fleet/Robots/ned/Data -u anna --json",
)


@connecting
def browse(
    connection: ConnectionOptions,
    node: Annotated[
        str, typer.Argument(help="NodeId, UA topic, path such as Fleet/Robots, or name such as ned or ned.pose.")
    ] = "Objects",
    depth: Annotated[int, typer.Option(help="Levels to go down.", min=1, max=20)] = 1,
    values: Annotated[bool, typer.Option("--values", help="Print the values too.")] = False,
    full: Full = False,
    utc: Utc = False,
    color: ColorOption = ColorWhen.AUTO,
    as_json: Json = False,
) -> None:
    """List the nodes below a node as a tree, with their types.

    Where --depth ends above other nodes, their number is told.
    """

    async def main() -> None:
        async with connected(connection) as client:
            infos = await client.browse(node, depth=depth)
            readings = await _readings(client, infos) if values else {}
            if as_json:
                for info in infos:
                    print_json(asdict(info) | _value_json(readings.get(info.node_id)))
                return
            styles: dict[str, ValueStyle] = {}
            if values:
                styles = await styles_of(client, list(readings), is_full=full, zone=zone_of(utc))
            texts = {one: _value_line(reading, styles.get(one)) for one, reading in readings.items()}
            for line in tree_lines(infos, texts, colours=has_colours(color)):
                write_line(line)
            left_out = left_out_text(infos, depth)
            if left_out:
                message(left_out)

    run(main())


async def _readings(client: FleetClient, infos: Sequence[NodeInfo]) -> dict[str, Reading]:
    variables = list(dict.fromkeys(info.node_id for info in infos if info.node_class == "Variable"))
    return dict(zip(variables, await client.read(variables), strict=True))


def _value_line(reading: Reading, style: ValueStyle | None) -> str:
    status = status_cell(reading).text
    return value_text(reading.value, reading.type_name, style) + (f"  {status}" if status else "")


def _value_json(reading: Reading | None) -> dict[str, object]:
    return {} if reading is None else {"value": reading.value, "status": reading.status_text}
