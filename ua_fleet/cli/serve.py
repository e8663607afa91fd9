"""`ua-fleet serve`: the OPC UA server."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from ua_fleet.cli.endings import extra_needed
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.monitored import monitored
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, WithoutLoopRule, load_config
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import collection_paused, run
from ua_fleet.cli.rules import rule_for
from ua_fleet.cli.traffic_log import TrafficLogFile, traffic_log
from ua_fleet.storage.process_lock import process_lock

__all__ = ["EXAMPLES", "serve"]

EXAMPLES = ("ua-fleet serve", "ua-fleet serve -c hall2.yaml --port 4841")


def serve(
    config: Config = DEFAULT_CONFIG,
    host: Annotated[str | None, typer.Option(help="Listen on this address instead of the file's.")] = None,
    port: Annotated[int | None, typer.Option(help="Listen on this port instead of the file's; 0: any.")] = None,
    as_json: Json = False,
    traffic_file: TrafficLogFile = None,
    without_loop_rule: WithoutLoopRule = False,
) -> None:
    """Run the OPC UA server of a fleet until Ctrl-C.

    Every robot and every data source of the configuration file becomes a node; bridges bring the values. Add a user
    first, with `ua-fleet user add NAME --role operator`: clients log in as a user.
    """
    with collection_paused() as settled:
        _serve(config, host, port, as_json, traffic_file, without_loop_rule, settled)


def _serve(
    config: Path,
    host: str | None,
    port: int | None,
    as_json: bool,
    traffic_file: Path | None,
    without_loop_rule: bool,
    settled: Callable[[], None],
) -> None:
    given = {"server.host": host, "server.port": port}
    fleet = load_config(config, overrides={key: value for key, value in given.items() if value is not None})
    set_up_logging(process="server")
    with extra_needed("the server", "server"):
        from ua_fleet.server.app import run_server
    from ua_fleet.monitoring import ProcessKind

    def ready(endpoint: str) -> None:
        settled()
        if as_json:
            print_json({"ready": True, "endpoint": endpoint})
        else:
            print_line(f"ready: {endpoint}")

    folder = config.resolve().parent
    watched = monitored(
        fleet.monitoring,
        ProcessKind.SERVER,
        fleet.fleet.name,
        folder / fleet.server.state_dir,
        port=fleet.server.monitoring_port,
        port_key="server.monitoring_port",
    )

    async def served(sent: Callable[[bytes, int], None] | None) -> None:
        rule = rule_for(without_loop_rule)
        async with watched as monitor:
            await run_server(fleet, folder, ready=ready, rule=rule, sent=sent, monitor=monitor, once=True)

    lock = process_lock(folder / fleet.server.state_dir / "server.lock", f"a server of {config}")
    with lock, traffic_log(traffic_file, fleet) as sent:
        message(f"serving {fleet.fleet.name} of {config}; end it with Ctrl-C")
        run(served(sent))
