"""`ua-fleet pubsub record` and `export`: messages as they were received, in a file and for other programs."""

from __future__ import annotations

import asyncio
import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.endings import UsageError, extra_needed
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json
from ua_fleet.cli.process import run
from ua_fleet.cli.pubsub import transport_of

if TYPE_CHECKING:
    from ua_fleet.config import FleetConfig

__all__ = ["EXPORT_EXAMPLES", "RECORD_EXAMPLES", "export", "fleet_of", "record"]

RECORD_EXAMPLES = (
    "ua-fleet pubsub record line.rec --timeout 3600",
    "ua-fleet pubsub record line.rec --url opc.udp://224.0.2.14:4840 --interface eth0 --size 100",
)
EXPORT_EXAMPLES = (
    "ua-fleet pubsub export line.rec line.mcap",
    "ua-fleet pubsub export line.rec line.pcapng",
    "ua-fleet pubsub export line.rec line.mcap --as-bridge floor",
)
MEBIBYTE = 1024 * 1024


def fleet_of(config: Path, url: object) -> FleetConfig | None:
    """The fleet that a tool is to know: none where it was given an address, and no file."""
    return load_config(config, allow_missing_ids=True) if url is None or config != DEFAULT_CONFIG else None


def record(
    file: Annotated[Path, typer.Argument(help="The file to write; it must not be there.")],
    url: Annotated[
        list[str] | None, typer.Option(help="Listen at this address instead of the file's; may be given several times.")
    ] = None,
    interface: Annotated[str | None, typer.Option(help="Name, address or subnet of the network interface.")] = None,
    timeout: Annotated[float | None, typer.Option(help="End after this number of seconds.", min=0.1)] = None,
    size: Annotated[float, typer.Option(help="End before the file has more than this number of MiB.", min=0.01)] = 1024,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Record the PubSub messages of a fleet in a file, as they are received, until Ctrl-C.

    Each with its time, where it came from, and which key it is secured with. Secured messages stay secured: recording
    needs no keys, and who has the file needs them to read it. Publishers are asked for their metadata once they are
    heard, so that the file can be read by itself. The file is compressed with zstd, and whole up to the last second
    whatever ends the command.
    """
    set_up_logging("warning")
    with extra_needed("a recording", "recording"):
        from ua_fleet.recording.files import RecordingWriter
    from ua_fleet.cli.recorder import Recorder
    from ua_fleet.config.connections import over_one
    from ua_fleet.config.security import publisher_ids
    from ua_fleet.config.teleoperation import setpoint_groups
    from ua_fleet.recording.records import Connection, Header, key_name

    fleet = fleet_of(config, url)
    fleets = [None] if fleet is None else [over_one(fleet, number) for number in range(len(fleet.connections))]
    places = [(fleets[0], one) for one in url] if url else [(each, each.pubsub.url) for each in fleets if each]
    urls = [one for _, one in places]
    transports = [transport_of(each, config.resolve().parent, one, interface) for each, one in places]
    setpoints = {} if fleet is None else dict(setpoint_groups(fleet))
    ids = None if fleet is None else publisher_ids(fleet)
    on = [interface or ("lo" if each is None else each.pubsub.interface) for each, _ in places]
    there = tuple([Connection(one, where) for one, where in zip(urls, on, strict=True)])
    header = Header(time.time_ns(), there, tuple(setpoints.items()))

    def key_of(datagram: bytes) -> str:
        return key_name(datagram if ids is None else ids.inward(datagram), setpoints)

    async def main() -> None:
        with RecordingWriter(file, header, round(size * MEBIBYTE)) as writer:
            recorder = Recorder(writer, transports, key_of)
            try:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(timeout):
                        await recorder.record(lambda: message(f"recording {', '.join(urls)} in {file}; Ctrl-C ends it"))
            finally:
                kernel_drops = sum(transport.stats.kernel_drops for transport in transports)
                figures = {
                    "datagrams": recorder.datagrams,
                    "bytes": writer.size,
                    "kernel_drops": kernel_drops,
                    "too_large": recorder.too_large,
                    "full": recorder.is_full and recorder.broken is None,
                }
        if as_json:
            print_json(figures)
        else:
            why = f"; the file has its {size:g} MiB" if figures["full"] else ""
            large = f", {recorder.too_large} too large for a recording" if recorder.too_large else ""
            message(f"{recorder.datagrams} datagrams in {file}, {kernel_drops} dropped by the kernel{large}{why}")
        if recorder.broken is not None:
            raise recorder.broken

    run(main())


def export(
    file: Annotated[Path, typer.Argument(help="A recording.")],
    out: Annotated[Path, typer.Argument(help="The file to write: *.mcap (Foxglove) or *.pcapng (Wireshark).")],
    key: Annotated[
        str | None,
        typer.Option(metavar="KEYDATA_HEX", envvar="UA_FLEET_PUBSUB_KEY", help="Decrypt messages with this key."),
    ] = None,
    as_bridge: Annotated[
        str | None, typer.Option(metavar="NAME", help="Ask the key service with the certificate of this bridge.")
    ] = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Write a recording for other programs.

    MCAP has a channel for each DataSet, with a JSON schema, and its values as JSON; secured messages need their keys:
    of the configuration file where there is one, or --key. pcapng has the datagrams as they were received, in IP and
    UDP headers that are made from their addresses; secured ones stay secured.
    """
    set_up_logging("warning")
    with extra_needed("a recording", "recording"):
        from ua_fleet.recording.files import read_recording
    from ua_fleet.cli.exports import write_mcap, write_pcapng

    if out.suffix not in (".mcap", ".pcapng"):
        raise UsageError(f"{out}: the name ends with .mcap or .pcapng, which says what is written")
    header, records = read_recording(file)
    try:
        target = out.open("xb")
    except OSError as error:
        raise UsageError(f"{out}: cannot be written ({error.strerror}); name another file") from error
    with contextlib.closing(target):
        if out.suffix == ".pcapng":
            figures = write_pcapng(header, records, target)
        else:
            fleet = load_config(config, allow_missing_ids=True) if config.exists() else None
            figures = asyncio.run(
                write_mcap(file, header, records, target, fleet, config.resolve().parent, key, as_bridge)
            )
    if as_json:
        print_json(figures)
    else:
        message(", ".join(f"{name} {count}" for name, count in figures.items()))
