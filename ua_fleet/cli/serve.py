"""`ua-fleet serve`: the OPC UA server."""

from __future__ import annotations

import asyncio
from pathlib import Path

from ua_fleet.cli.options import Config, Json, WithoutLoopRule, load_config
from ua_fleet.cli.output import message, print_json, print_line, set_up_logging
from ua_fleet.cli.rules import rule_for
from ua_fleet.errors import BridgeUnavailable

__all__ = ["serve"]


def serve(
    config: Config = Path("fleet.yaml"), as_json: Json = False, without_loop_rule: WithoutLoopRule = False
) -> None:
    """Run the OPC UA server of a fleet until Ctrl-C.

    Every robot and every data source of the configuration file becomes a node; bridges bring the values. Add a user
    first, with `ua-fleet user add NAME --role operator`, since nobody gets in without one.
    """
    fleet = load_config(config)
    set_up_logging()
    try:
        from ua_fleet.server.app import run_server
    except ImportError as error:
        raise BridgeUnavailable(f"the server cannot run: {error}", extra="server") from error

    def ready(endpoint: str) -> None:
        if as_json:
            print_json({"ready": True, "endpoint": endpoint})
        else:
            print_line(f"ready: {endpoint}")

    message(f"serving {fleet.fleet.name} of {config}; end it with Ctrl-C")
    asyncio.run(run_server(fleet, config.resolve().parent, ready=ready, rule=rule_for(without_loop_rule)))
