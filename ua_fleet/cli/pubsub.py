"""`ua-fleet pubsub listen`: what is said between the server and the bridges."""

from __future__ import annotations

import asyncio
import json
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message
from ua_fleet.cli.process import run
from ua_fleet.cli.pubsub_connection import ConnectionName, on_connection
from ua_fleet.errors import SendTimeout

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig
    from ua_fleet.transport.base import Transport

__all__ = ["EXAMPLES", "listen", "transport_of"]

EXAMPLES = (
    "ua-fleet pubsub listen",
    "ua-fleet pubsub listen --url opc.udp://224.0.2.14:4840 --interface eth0 --timeout 10",
    "ua-fleet pubsub listen --count 5 --json",
    "ua-fleet pubsub listen --as-bridge floor",
    "ua-fleet pubsub listen --url opc.udp://224.0.2.14:4840 --key KEYDATA_HEX",
)


def transport_of(fleet: FleetConfig | None, folder: Path, url: str | None, interface: str | None) -> Transport:
    """Where a tool listens: as the options say, otherwise as the configuration file in a folder does."""
    if fleet is not None:
        from ua_fleet.config.transports import open_transport

        return open_transport(fleet, folder, space=None, url=url, interface=interface)
    from ua_fleet.transport.mqtt.address import is_broker_url

    if is_broker_url(url or ""):
        from ua_fleet.transport.mqtt.credentials import Credentials
        from ua_fleet.transport.mqtt.topics import TopicTree
        from ua_fleet.transport.mqtt.transport import MqttTransport

        has_tls = (url or "").startswith("mqtts:")
        return MqttTransport(url or "", TopicTree(), Credentials.read(folder, has_tls=has_tls))
    from ua_fleet.transport.udp import UdpTransport

    return UdpTransport(url or "", interface or "lo")


def listen(
    url: Annotated[str | None, typer.Option(help="Listen at this address instead of the file's.")] = None,
    interface: Annotated[str | None, typer.Option(help="Name, address or subnet of the network interface.")] = None,
    count: Annotated[int | None, typer.Option(help="End after this number of lines.", min=1)] = None,
    timeout: Annotated[float | None, typer.Option(help="End after this number of seconds.", min=0.1)] = None,
    key: Annotated[
        str | None,
        typer.Option(
            metavar="KEYDATA_HEX",
            envvar="UA_FLEET_PUBSUB_KEY",
            help="Decrypt messages with this key instead of the file's keys.",
        ),
    ] = None,
    as_bridge: Annotated[
        str | None, typer.Option(metavar="NAME", help="Ask the key service with the certificate of this bridge.")
    ] = None,
    connection: ConnectionName = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Print the PubSub messages of a fleet, one line each, until Ctrl-C.

    Shown are new values, metadata, announcements, and sources that fall silent or return; repeats and keep-alives are
    only counted. Sources whose metadata is not known yet are asked for it. Messages are verified and decrypted with
    the keys of the configuration file; where the key service has them, --as-bridge is needed. Of a secured message
    without its key, and of one that is refused, the headers are shown. With --url and no --config there are no keys.
    At the end the counters are printed to stderr. Exit code 5 if nothing at all, or less than --count, came within
    --timeout.
    """
    set_up_logging("warning")
    from ua_fleet.cli.listener import MessagePrinter, figures_text
    from ua_fleet.cli.opening import Opener, lacks_keys, tool_envelope, tool_keys
    from ua_fleet.cli.pubsub_decode import key_of
    from ua_fleet.config.teleoperation import setpoint_groups
    from ua_fleet.counters import Counters
    from ua_fleet.pubsub.timing import PubSubTiming

    one_key = None if key is None else key_of(key)
    fleet = None
    if url is None or config != DEFAULT_CONFIG:
        fleet = on_connection(load_config(config, allow_missing_ids=True), connection)
    transport, counters = transport_of(fleet, config.resolve().parent, url, interface), Counters()
    if one_key is not None:
        keyed = None
    elif fleet is not None and lacks_keys(fleet, as_bridge):
        keyed = None
        message("keys come from the key service: name a bridge with a trusted certificate (--as-bridge NAME)")
    else:
        keyed = fleet
    envelope = tool_envelope(keyed, counters)
    timing = PubSubTiming() if fleet is None else fleet.pubsub.timing()
    listener = MessagePrinter(
        timing,
        Opener(counters, envelope, one_key),
        count=count,
        as_json=as_json,
        setpoint_groups=None if fleet is None else setpoint_groups(fleet),
    )
    keys_of_fleet = nullcontext() if keyed is None else tool_keys(keyed, envelope, config.resolve().parent, as_bridge)

    async def main() -> None:
        try:
            async with asyncio.timeout(timeout), keys_of_fleet as keys:
                await listener.listen(transport, keys)
        except TimeoutError:
            if count is not None:
                raise SendTimeout(f"{count} lines did not come within {timeout} s; try a longer --timeout") from None
            if not transport.stats.received:
                raise SendTimeout(
                    f"no message arrived within {timeout} s; check that a server or bridge runs with this url "
                    "and interface"
                ) from None
        finally:
            figures = {**listener.figures(), "kernel_drops": transport.stats.kernel_drops}
            message(json.dumps(figures) if as_json else figures_text(figures))

    run(main())
