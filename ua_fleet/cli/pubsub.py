"""`ua-fleet pubsub listen`: what is said between the server and the bridges."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message
from ua_fleet.cli.process import run
from ua_fleet.errors import SendTimeout

if TYPE_CHECKING:
    from ua_fleet.pubsub.timing import PubSubTiming
    from ua_fleet.transport.udp import UdpTransport

__all__ = ["EXAMPLES", "listen"]

EXAMPLES = (
    "ua-fleet pubsub listen",
    "ua-fleet pubsub listen --url opc.udp://224.0.2.14:4840 --interface eth0 --timeout 10",
    "ua-fleet pubsub listen --count 5 --json",
)


def _connection(config: Path, url: str | None, interface: str | None) -> tuple[UdpTransport, PubSubTiming]:
    from ua_fleet.pubsub.timing import PubSubTiming
    from ua_fleet.transport.udp import UdpTransport

    if url is not None:
        return UdpTransport(url, interface or "lo"), PubSubTiming()
    pubsub = load_config(config, allow_missing_ids=True).pubsub
    transport = UdpTransport(
        pubsub.url,
        interface or pubsub.interface,
        ttl=pubsub.ttl,
        receive_buffer_bytes=pubsub.receive_buffer_bytes,
    )
    return transport, PubSubTiming(pubsub.keep_alive_s, pubsub.receive_timeout_s, pubsub.repeat_interval_s)


def listen(
    url: Annotated[str | None, typer.Option(help="Listen here, and not where the configuration file says.")] = None,
    interface: Annotated[str | None, typer.Option(help="Name or address of the network interface.")] = None,
    count: Annotated[int | None, typer.Option(help="End after so many lines.", min=1)] = None,
    timeout: Annotated[float | None, typer.Option(help="End after so many seconds.", min=0.1)] = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Print the PubSub messages of a fleet, one line each, until Ctrl-C.

    Shown are new values, metadata, and sources that fall silent or return; repeats and keep-alives are only counted.
    Sources whose metadata is not known yet are asked for it. At the end the counters are printed to stderr. Exit code 5
    if nothing at all, or less than --count, came within --timeout.
    """
    set_up_logging("warning")
    from ua_fleet.cli.listener import Listener, figures_text

    transport, timing = _connection(config, url, interface)

    async def main() -> None:
        listener = Listener(timing, count=count, as_json=as_json)
        try:
            async with asyncio.timeout(timeout):
                await listener.listen(transport)
        except TimeoutError:
            if count is not None:
                raise SendTimeout(f"{count} lines did not come within {timeout} s; try a longer --timeout") from None
            if not transport.stats.received:
                raise SendTimeout(
                    f"nothing was heard for {timeout} s; are a server or a bridge running, with this url and interface?"
                ) from None
        finally:
            figures = {**listener.figures(), "kernel_drops": transport.stats.kernel_drops}
            message(json.dumps(figures) if as_json else figures_text(figures))

    run(main())
