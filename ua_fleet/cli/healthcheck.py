"""`ua-fleet healthcheck`: whether a process is well, for containers and supervisors."""

from __future__ import annotations

from typing import Annotated

import typer

from ua_fleet.cli.health import DEFAULT_STATE_DIR, DEFAULT_TIMEOUT_S, DEFAULT_WITHIN_S, HealthQuestion, check, tell
from ua_fleet.cli.options import Json

__all__ = ["EXAMPLES", "healthcheck"]

EXAMPLES = (
    "ua-fleet healthcheck",
    "ua-fleet healthcheck --state-dir state/bridges/cell",
    "ua-fleet healthcheck --at 127.0.0.1:9464 --live",
    "ua-fleet healthcheck --tcp 127.0.0.1:11311",
    "ua-fleet healthcheck --heartbeat /tmp/robot.beat --within 5",
)


def healthcheck(
    at: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Ask the process that answers at this address.")
    ] = None,
    state_dir: Annotated[
        str | None,
        typer.Option(
            metavar="DIR", help=f"Ask the process whose files are in this folder.  [default: {DEFAULT_STATE_DIR}]"
        ),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Check only that the process answers, ready or not.")] = False,
    tcp: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Check that this TCP port accepts connections.")
    ] = None,
    heartbeat: Annotated[
        str | None, typer.Option(metavar="FILE", help="Check that a program has touched this file.")
    ] = None,
    within: Annotated[
        float, typer.Option(help="Greatest age of the heartbeat, in seconds.", min=0.001)
    ] = DEFAULT_WITHIN_S,
    timeout: Annotated[float, typer.Option(help="Time limit for an answer, in seconds.", min=0.001)] = (
        DEFAULT_TIMEOUT_S
    ),
    as_json: Json = False,
) -> None:
    """Check the health of one process and print it in one line; the exit code is 0 if it is well, and 1 if not.

    The server, each bridge and relay, and the Modbus gateway answer whether they are ready. Any other program is well
    while its TCP port accepts connections, or while it touches a file.
    """
    raise typer.Exit(tell(check(HealthQuestion(at, state_dir, live, tcp, heartbeat, within, timeout)), as_json=as_json))
