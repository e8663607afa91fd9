"""`ua-fleet pubsub replay`: recorded values as those of another origin."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ua_fleet.cli.endings import UsageError, extra_needed
from ua_fleet.cli.logs import set_up_logging
from ua_fleet.cli.options import DEFAULT_CONFIG, Config, Json, load_config
from ua_fleet.cli.output import message, print_json
from ua_fleet.cli.process import run
from ua_fleet.cli.pubsub import transport_of
from ua_fleet.cli.pubsub_connection import ConnectionName, on_connection

if TYPE_CHECKING:
    from ua_fleet.cli.opening import ToolKeys
    from ua_fleet.config import FleetConfig
    from ua_fleet.counters import Counters
    from ua_fleet.pubsub.publisher import Publisher
    from ua_fleet.pubsub.security.envelope import Envelope
    from ua_fleet.topics import Topic
    from ua_fleet.transport.party import Party

__all__ = ["EXAMPLES", "replay"]

EXAMPLES = (
    "ua-fleet pubsub replay line.rec",
    "ua-fleet pubsub replay line.rec --speed 10 --only 'ua_1_2_*'",
    "ua-fleet pubsub replay line.rec --connection site",
    "ua-fleet pubsub replay line.rec --to opc.udp://239.0.0.9:4840 --namespace 4",
)
STATE_DIR = Path("state/replay")


def replay(
    file: Annotated[Path, typer.Argument(help="A recording.")],
    speed: Annotated[float, typer.Option(help="So many times as fast as it was.", min=0.01, max=1000)] = 1.0,
    only: Annotated[
        list[str] | None, typer.Option(metavar="PATTERN", help="Only recorded topics like this, e.g. 'ua_1_2_*'.")
    ] = None,
    to: Annotated[str | None, typer.Option(metavar="URL", help="Send to this address instead of the file's.")] = None,
    interface: Annotated[str | None, typer.Option(help="Name, address or subnet of the network interface.")] = None,
    space: Annotated[
        int, typer.Option(help="Origin of the replayed values: a vendor space of its own.", min=256, max=65_535)
    ] = 65_535,
    namespace: Annotated[
        int | None, typer.Option(help="Index of the namespace for all ids; left out: as recorded.", min=2, max=65_535)
    ] = None,
    key: Annotated[
        str | None,
        typer.Option(metavar="KEYDATA_HEX", envvar="UA_FLEET_PUBSUB_KEY", help="Decrypt messages with this key."),
    ] = None,
    as_bridge: Annotated[
        str | None, typer.Option(metavar="NAME", help="Ask the key service with the certificate of this bridge.")
    ] = None,
    connection: ConnectionName = None,
    config: Config = DEFAULT_CONFIG,
    as_json: Json = False,
) -> None:
    """Publish the values of a recording again, with the times that they had.

    Never as live: their origin is the space of the replay, not the one they came from, and their status is
    Uncertain_SubstituteValue, or the Bad one that they had. Bridges keep them out of their robots' spaces. Actions,
    setpoints, events and announced robots are left out. With --to and no --config there are no keys. A secured
    fleet needs a key file t-65535 (`ua-fleet keys create t-65535`); its key service makes keys for bridges alone.
    """
    set_up_logging("warning")
    with extra_needed("a recording", "recording"):
        from ua_fleet.recording.files import read_recording
    from ua_fleet.cli.exports import opener_of
    from ua_fleet.cli.replayer import Replayer
    from ua_fleet.counters import Counters
    from ua_fleet.pubsub.publisher import Publisher
    from ua_fleet.pubsub.subscriber import Subscriber
    from ua_fleet.pubsub.timing import PubSubTiming
    from ua_fleet.recording.playback import Playback, Replay
    from ua_fleet.transport.party import Brokered
    from ua_fleet.transport.sealed import SealedSender
    from ua_fleet.wire import Codec

    known = load_config(config, allow_missing_ids=True) if to is None or config.exists() else None
    fleet = None if known is None or (to is not None and config == DEFAULT_CONFIG) else on_connection(known, connection)
    check_space(known, space)
    folder = config.resolve().parent
    header, records = read_recording(file)
    recorded, counters = Counters(), Counters()

    def wanted(topic: Topic) -> bool:
        return not only or any(fnmatchcase(topic.name, pattern) for pattern in only)

    async def main() -> None:
        loop = asyncio.get_running_loop()
        opener = await opener_of(file, header, recorded, known, folder, key, as_bridge)
        async with AsyncExitStack() as stack:
            envelope, keys = await sending_envelope(fleet, space, counters, folder, stack)
            timing = PubSubTiming() if fleet is None else fleet.pubsub.timing()
            publisher = Publisher(space, timing, counters, Codec(), max_packed_bytes=envelope.max_plain_bytes)
            told = Replay(publisher, space, wanted, namespace)
            transport = transport_of(fleet, folder, to, interface)
            if isinstance(transport, Brokered):
                transport.speak_for(party_of(space, envelope, publisher))
            replayer = Replayer(
                told,
                Playback(recorded, timing, dict(header.setpoint_groups)),
                opener,
                publisher,
                Subscriber(space, timing, Counters(), Codec(), envelope=envelope),
                SealedSender(envelope, transport, loop.time),
                speed,
                keys,
            )
            try:
                await replayer.play(transport, records)
            finally:
                unopened = {str(cause): count for cause, count in recorded.drops.items() if count}
                figures = {
                    "datagrams": replayer.records,
                    "values": told.values,
                    "sources": {topic.name: now.name for topic, now in told.topics.items()},
                    "commands_left_out": opener.left_out,
                    "drops": unopened,
                }
        if as_json:
            print_json(figures)
        else:
            message(
                f"{told.values} values of {len(told.topics)} sources replayed as those of space {space}; "
                f"{opener.left_out} commands left out"
            )
            if recorded.drops.get("secured"):
                message(f"{recorded.drops['secured']} messages stayed closed for want of their keys")

    run(main())


def party_of(space: int, envelope: Envelope, publisher: Publisher) -> Party:
    """A replay as a transport over a broker needs it. What the broker had kept is nothing to it."""
    from ua_fleet.transport.party import Party
    from ua_fleet.wire.security import SecurityMode

    return Party(
        publisher_id=space,
        seal=envelope.seal,
        token=envelope.sending_token,
        is_secured=envelope.mode is not SecurityMode.NONE,
        names_of=publisher.names_of,
        receive_kept=lambda _datagram, _sender: None,
    )


def check_space(fleet: FleetConfig | None, space: int) -> None:
    """Raise UsageError where a bridge of the fleet stands in a space: its robots' values would be mixed with others."""
    for name, bridge in ({} if fleet is None else fleet.bridges).items():
        if bridge.space == space:
            raise UsageError(f"space {space} is that of bridge {name}; name another one for the replay with --space")


async def sending_envelope(
    fleet: FleetConfig | None, space: int, counters: Counters, folder: Path, stack: AsyncExitStack
) -> tuple[Envelope, ToolKeys | None]:
    """What secures replayed messages, and what keeps it in keys; raises ConfigError where there can be no keys."""
    from ua_fleet.cli.opening import ToolKeys, source_of
    from ua_fleet.config.security import envelope_of
    from ua_fleet.errors import ConfigError
    from ua_fleet.keys.files import FileKeySource
    from ua_fleet.pubsub.security.envelope import Envelope
    from ua_fleet.pubsub.security.groups import telemetry_group
    from ua_fleet.pubsub.security.nonces import MemoryNonces
    from ua_fleet.wire.security import SecurityMode

    if fleet is None:
        return Envelope(space, counters, mode=SecurityMode.NONE, nonces=MemoryNonces()), None
    if not fleet.pubsub.is_secured:
        return envelope_of(fleet, space, counters, folder / STATE_DIR), None
    if fleet.pubsub.keys.source != "files":
        raise ConfigError(
            "the key service makes keys for bridges alone, and a replay is none",
            key="pubsub.keys.source",
            suggestion="replay to a group of its own, without keys: --to opc.udp://239.0.0.9:4840",
        )
    source = await stack.enter_async_context(source_of(fleet, folder, None))
    assert isinstance(source, FileKeySource)
    source.check([telemetry_group(space)], [])
    envelope = envelope_of(fleet, space, counters, folder / STATE_DIR)
    keys = ToolKeys(envelope, source)
    await keys.refresh()
    return envelope, keys
