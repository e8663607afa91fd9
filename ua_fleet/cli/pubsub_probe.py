"""`ua-fleet pubsub probe`: ask Publishers what they announce."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from typing import Annotated

import typer

from ua_fleet.cli.kind import HealthKind
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json, print_table
from ua_fleet.cli.process import run
from ua_fleet.cli.pubsub import transport_of
from ua_fleet.cli.pubsub_connection import ConnectionName, on_connection
from ua_fleet.errors import SendTimeout

__all__ = ["EXAMPLES", "nothing_heard", "probe"]

EXAMPLES = (
    "ua-fleet pubsub probe",
    "ua-fleet pubsub probe --kind metadata 2",
    "ua-fleet pubsub probe --kind actions --as-bridge floor",
    "ua-fleet pubsub probe --kind endpoints 0 --url opc.udp://224.0.2.14:4840 --interface eth0 --json",
)


def probe(
    publisher_id: Annotated[
        int | None,
        typer.Argument(
            help="The Publisher to ask, by the number of its space. Without it: all Publishers that are found.",
            min=0,
            max=65_535,
        ),
    ] = None,
    kind: Annotated[HealthKind, typer.Option(help="What to ask for.")] = HealthKind.APPLICATIONS,
    url: Annotated[str | None, typer.Option(help="Ask at this address instead of the file's.")] = None,
    interface: Annotated[str | None, typer.Option(help="Name or address of the network interface.")] = None,
    timeout: Annotated[float, typer.Option(help="Time limit for answers, in seconds.", min=0.1)] = 3.0,
    as_bridge: Annotated[
        str | None, typer.Option(metavar="NAME", help="Ask the key service with the certificate of this bridge.")
    ] = None,
    connection: ConnectionName = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Ask Publishers over PubSub what they are, what they send and what they can be asked to do.

    A probe that is not answered is sent again after 0.5 s, then after twice as long. Answers of a secured fleet are
    verified and decrypted with the keys of the configuration file; where the key service has them, --as-bridge is
    needed. With --url and no --config there are no keys. Exit code 5 if nobody answers within --timeout.
    """
    set_up_logging("warning")
    from ua_fleet.cli.discovery_json import announcement_as_json
    from ua_fleet.cli.opening import Opener, lacks_keys, tool_envelope, tool_keys
    from ua_fleet.cli.probe_tables import table
    from ua_fleet.cli.prober import Prober
    from ua_fleet.counters import Counters

    fleet = None
    if url is None or config != DEFAULT_CONFIG:
        fleet = on_connection(load_config(config, allow_missing_ids=True), connection)
    keyed = None if fleet is None or lacks_keys(fleet, as_bridge) else fleet
    transport, counters = transport_of(fleet, config.resolve().parent, url, interface), Counters()
    envelope = tool_envelope(keyed, counters)
    prober = Prober(kind, publisher_id, Opener(counters, envelope))
    keys_of_fleet = nullcontext() if keyed is None else tool_keys(keyed, envelope, config.resolve().parent, as_bridge)

    async def main() -> None:
        async with keys_of_fleet as keys:
            await prober.ask(transport, keys, timeout)

    run(main())
    if not prober.answers:
        raise SendTimeout(nothing_heard(kind, publisher_id, timeout, counters.drops, bool(prober.found)))
    if as_json:
        for announcement in prober.answers:
            print_json({"publisher_id": announcement.publisher_id, **announcement_as_json(announcement)})
    else:
        print_table(table(kind, prober.answers))
    silent = prober.found - prober.answered
    if silent:
        message(f"heard, but no answer within {timeout:g} s: {', '.join(sorted(map(str, silent)))}")


def nothing_heard(
    kind: HealthKind, publisher_id: int | None, timeout: float, drops: Mapping[str, int], heard: bool
) -> str:
    """Why there may be no answer, and what to try."""
    asked = "nobody answered" if publisher_id is None else f"publisher {publisher_id} did not answer"
    refused = ", ".join(f"{count} dropped as {cause}" for cause, count in sorted(drops.items()) if count)
    if refused:
        reason = f"{refused}: give the fleet's file with -c, and --as-bridge where its keys come from the key service"
    elif heard:
        reason = "others are heard, so url and interface are right; `ua-fleet pubsub probe` shows who is there"
    else:
        reason = "is it running, with this url and interface? `ua-fleet pubsub listen --timeout 10` shows what is heard"
    return f"{asked} with {kind.value} within {timeout:g} s; {reason}"
