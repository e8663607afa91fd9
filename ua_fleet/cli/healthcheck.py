"""`ua-fleet healthcheck`: whether a process is well, for containers and supervisors."""

from __future__ import annotations

from typing import Annotated

import typer

from ua_fleet.cli.health import DEFAULT_STATE_DIR, DEFAULT_TIMEOUT_S, DEFAULT_WITHIN_S, Asked, check, tell
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
    at: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Ask the process that answers there.")] = None,
    state_dir: Annotated[
        str | None,
        typer.Option(
            metavar="DIR", help=f"Ask the process that keeps its files there.  [default: {DEFAULT_STATE_DIR}]"
        ),
    ] = None,
    live: Annotated[bool, typer.Option("--live", help="Ask whether it answers at all, ready or not.")] = False,
    tcp: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Something has to accept there.")] = None,
    heartbeat: Annotated[str | None, typer.Option(metavar="FILE", help="A program has to touch this file.")] = None,
    within: Annotated[float, typer.Option(help="How long ago, in seconds, at most.", min=0.001)] = DEFAULT_WITHIN_S,
    timeout: Annotated[float, typer.Option(help="Longest wait for an answer, in seconds.", min=0.001)] = (
        DEFAULT_TIMEOUT_S
    ),
    as_json: Json = False,
) -> None:
    """Tell in one line whether a process is well; the exit code is 0 if it is, and 1 if not.

    The server, each bridge and the Modbus gateway are asked whether they are ready. Other programs are well while
    something accepts connections, or while they touch a file.
    """
    raise typer.Exit(tell(check(Asked(at, state_dir, live, tcp, heartbeat, within, timeout)), as_json=as_json))
