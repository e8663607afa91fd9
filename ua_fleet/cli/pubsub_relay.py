"""`ua-fleet pubsub relay NAME`: data from one PubSub connection to another."""

from __future__ import annotations

from typing import Annotated

import typer

from ua_fleet.cli.endings import NotFound
from ua_fleet.cli.key_source import relay_key_source_of
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.monitored import monitored
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json, print_line
from ua_fleet.cli.process import run

__all__ = ["EXAMPLES", "relay"]

EXAMPLES = ("ua-fleet pubsub relay gate", "ua-fleet pubsub relay gate -c hall2.yaml")


def relay(
    name: Annotated[str, typer.Argument(help="Name of the relay in the configuration file.")],
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Forward data between the PubSub connections of a fleet until Ctrl-C.

    What goes from where to where stands in `relays` of the configuration file. Values, keep-alives, metadata and the
    states of publishers are forwarded as they are, between UDP and MQTT, UADP and JSON, and secured with the relay's
    own keys (r-NAME). Actions and setpoints are never forwarded: robots are commanded over the connections of their
    bridges. Where keys come from the key service, the relay needs a certificate: ua-fleet cert create --bridge NAME.
    """
    fleet = load_config(config)
    if name not in fleet.relays:
        there = ", ".join(fleet.relays) or "none"
        raise NotFound(f"{config}: there is no relay {name!r}; relays there: {there}")
    set_up_logging(process="relay", relay=name)
    from ua_fleet.config.transports import relay_transports
    from ua_fleet.monitoring import ProcessKind
    from ua_fleet.relay import run_relay

    folder = config.resolve().parent
    transports = relay_transports(fleet, folder, name)
    state_dir = folder / fleet.state_dir_of(name)
    source = relay_key_source_of(fleet, name, folder, state_dir)

    def ready() -> None:
        if as_json:
            print_json({"ready": True, "relay": name})
        else:
            print_line(f"ready: relay {name}")

    async def relayed() -> None:
        watched = monitored(
            fleet.monitoring,
            ProcessKind.RELAY,
            name,
            state_dir,
            port=fleet.relays[name].monitoring_port,
            port_key=f"relays.{name}.monitoring_port",
        )
        async with watched as monitor, source as keys:
            await run_relay(fleet, name, transports, state_dir=state_dir, keys=keys, ready=ready, monitor=monitor)

    ways = [f"{each.source} to {each.target}" for each in fleet.relays[name].forwards]
    message(f"relay {name} ({', '.join(dict.fromkeys(ways))}); end it with Ctrl-C")
    run(relayed())
