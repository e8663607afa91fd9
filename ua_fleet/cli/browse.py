"""`ua-fleet browse`: the nodes below a node."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from ua_fleet.cli.connect import connected
from ua_fleet.cli.options import (
    DEFAULT_ENDPOINT,
    Connection,
    Endpoint,
    Insecure,
    Json,
    PasswordFile,
    Policy,
    SecurityPolicy,
    Timeout,
    User,
)
from ua_fleet.cli.output import print_json, print_line
from ua_fleet.cli.process import run

__all__ = ["EXAMPLES", "browse"]

EXAMPLES = ("ua-fleet browse -u anna", "ua-fleet browse Fleet/Robots/ned --depth 2 -u anna")


def browse(
    node: Annotated[str, typer.Argument(help="NodeId, UA topic, or path such as Fleet/Robots.")] = "Objects",
    depth: Annotated[int, typer.Option(help="Levels to go down.", min=1, max=20)] = 1,
    endpoint: Endpoint = DEFAULT_ENDPOINT,
    user: User = None,
    password_file: PasswordFile = None,
    policy: SecurityPolicy = Policy.BASIC256SHA256,
    insecure: Insecure = False,
    timeout: Timeout = 10.0,
    as_json: Json = False,
) -> None:
    """List the nodes below a node."""
    connection = Connection.of(endpoint, user, password_file, policy, insecure, timeout)

    async def main() -> None:
        async with connected(connection) as client:
            for info in await client.browse(node, depth=depth):
                if as_json:
                    print_json(asdict(info))
                else:
                    shown = "" if info.display_name == info.browse_name else f" ({info.display_name})"
                    print_line(f"{'  ' * info.depth}{info.browse_name}{shown}  [{info.node_class}]  {info.node_id}")

    run(main())
