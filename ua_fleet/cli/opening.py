"""How tools that only look at a fleet's messages open them: with the fleet's keys, with one key, or without any."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Final, NamedTuple

from ua_fleet.cli.key_source import service_keys_of
from ua_fleet.cli.output import message
from ua_fleet.config.relays import relays_of_publishers
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups, publisher_ids, security_mode_of
from ua_fleet.config.teleoperation import setpoint_groups
from ua_fleet.counters import Counters, Drop
from ua_fleet.errors import ConfigError, KeySourceUnavailable, KeysRefused, RemoteWireError
from ua_fleet.keys.files import FileKeySource
from ua_fleet.keys.source import CURRENT_TOKEN, KeySource
from ua_fleet.pubsub.security.envelope import Envelope
from ua_fleet.pubsub.security.groups import telemetry_group
from ua_fleet.pubsub.security.nonces import MemoryNonces
from ua_fleet.pubsub.security.refused import DatagramRefused
from ua_fleet.transport.base import Transport
from ua_fleet.wire.security import MessageKey, SecuredDatagram, SecurityMode, SecurityPolicy, read_security

__all__ = [
    "REFRESH_S",
    "TOOL_SPACE",
    "OpenedDatagram",
    "Opener",
    "ToolKeys",
    "lacks_keys",
    "source_of",
    "tool_envelope",
    "tool_keys",
]

REFRESH_S: Final = 0.5
"""How often `ToolKeys.refresh` is to be called."""
ASK_AGAIN_S: Final = 5.0
"""Between two questions for one group, where asking costs."""
KEYS_AT_ONCE: Final = 8
MOST_TOLD: Final = 16
"""Different problems that are told: what is on the wire must not fill the terminal."""

TOOL_SPACE: Final = 255
"""PublisherId of a tool: reserved (docs/topics.md), so that nothing that is heard is its own."""


class OpenedDatagram(NamedTuple):
    """What became of one datagram."""

    plain: bytes | None
    """The whole plain message; None where it was not opened, or chunks are missing."""
    heard: SecuredDatagram | None = None
    """What its headers say; None where they cannot be read."""
    verified: bool | None = None
    """None where there is nothing to verify, or no key."""
    drop: Drop | None = None
    """Why it was not opened."""
    reason: str = ""


class Opener:
    """Opens datagrams and says what it saw. What is not opened is counted."""

    def __init__(self, counters: Counters, envelope: Envelope, key: MessageKey | None = None) -> None:
        """Make an opener.

        Args:
            counters: drops are counted here.
            envelope: of the fleet, with its keys; of mode None where there are none, or one `key`.
            key: the one key that secured messages are opened with, whatever their group and token.
        """
        self.counters = counters
        self._envelope, self._key = envelope, key

    def open(self, datagram: bytes, now: float, *, is_fresh: bool = True) -> OpenedDatagram:
        """Take one datagram; `is_fresh` as in `Envelope.open`."""
        try:
            heard = read_security(datagram)
        except RemoteWireError as error:
            self.counters.drop_malformed(error.cause)
            return OpenedDatagram(None, None, drop=Drop.MALFORMED, reason=str(error))
        is_secured = heard.mode is not SecurityMode.NONE
        try:
            if is_secured and self._envelope.mode is SecurityMode.NONE:
                if self._key is None:
                    return self._dropped(heard, Drop.SECURED, None, "")
                datagram = self._key.unprotect(heard)
            plain = self._envelope.open(datagram, now, is_fresh=is_fresh)
        except DatagramRefused as refused:
            return self._dropped(heard, refused.drop, _verdict(refused.drop), refused.detail)
        except RemoteWireError as error:
            if is_secured and error.cause == "signature":
                return self._dropped(heard, Drop.BAD_SIGNATURE, False, error.detail)
            self.counters.drop_malformed(error.cause)
            return OpenedDatagram(None, heard, True if is_secured else None, Drop.MALFORMED, str(error))
        if plain is None and heard.is_action and is_secured:
            return self._dropped(heard, Drop.SECURED, None, "an Action of a group whose keys we do not have")
        if plain is None and is_secured and self._envelope.is_setpoint(heard):
            return self._dropped(heard, Drop.SECURED, None, "a setpoint of a group whose keys we do not have")
        return OpenedDatagram(plain, heard, True if is_secured else None)

    def send(self, transport: Transport, probe: bytes) -> None:
        """Send a probe, which nothing secures."""
        for datagram in self._envelope.seal(probe, 0.0):
            transport.send(datagram)

    def _dropped(self, heard: SecuredDatagram, drop: Drop, verified: bool | None, reason: str) -> OpenedDatagram:
        self.counters.drop(drop)
        return OpenedDatagram(None, heard, verified, drop, reason)


def _verdict(drop: Drop) -> bool | None:
    """What a refusal says of the signature."""
    return {Drop.BAD_SIGNATURE: False, Drop.REPLAYED: True}.get(drop)


def lacks_keys(fleet: FleetConfig, as_bridge: str | None) -> bool:
    """Whether a tool can have no keys of this fleet: the service has them, and wants to see a bridge's certificate."""
    pubsub = fleet.pubsub
    return pubsub.is_secured and pubsub.keys.from_server and as_bridge is None


def tool_envelope(fleet: FleetConfig | None, counters: Counters) -> Envelope:
    """The envelope of a tool; of mode None without a fleet."""
    if fleet is None:
        return Envelope(TOOL_SPACE, counters, mode=SecurityMode.NONE, nonces=MemoryNonces())
    pubsub = fleet.pubsub
    envelope = Envelope(
        TOOL_SPACE,
        counters,
        mode=security_mode_of(fleet.pubsub),
        nonces=MemoryNonces(),
        relaxed_replay=pubsub.relaxed_replay,
        max_datagram_bytes=pubsub.max_datagram_bytes,
        max_message_bytes=pubsub.max_message_bytes,
        past_keys=pubsub.keys.past_keys,
        asks_for_all=pubsub.keys.source == "files",
        setpoint_groups=setpoint_groups(fleet),
        publisher_ids=publisher_ids(fleet),
        relayed=relays_of_publishers(fleet, 0),
    )
    if pubsub.is_secured:
        for group_id in all_groups(fleet):
            envelope.want(group_id)
    return envelope


class ToolKeys:
    """Keeps a tool's envelope in keys: `refresh` is called now and then."""

    def __init__(self, envelope: Envelope, source: KeySource) -> None:
        self._envelope, self._source = envelope, source
        self._next_at: dict[str, float] = {}
        self._told: set[str] = set()

    async def refresh(self) -> None:
        """Ask for what is missing, and for news where asking costs nothing. Says once why something is not there."""
        clock = asyncio.get_running_loop().time
        wanted = set(self._envelope.keys_wanted(clock()))
        for group_id in self._envelope.groups_wanted():
            if group_id == telemetry_group(TOOL_SPACE):  # a tool publishes nothing
                continue
            cheap = not math.isinf(self._source.refresh_s)
            if (group_id in wanted or cheap) and clock() >= self._next_at.get(group_id, -math.inf):
                self._next_at[group_id] = clock() + (REFRESH_S if cheap else ASK_AGAIN_S)
                try:
                    keys = await self._source.fetch(group_id, CURRENT_TOKEN, KEYS_AT_ONCE)
                except KeysRefused as error:
                    self._tell(str(error))
                except KeySourceUnavailable as error:
                    self._tell(str(error))
                    return
                else:
                    self._envelope.install(group_id, keys, clock())

    def _tell(self, text: str) -> None:
        if text not in self._told and len(self._told) < MOST_TOLD:
            self._told.add(text)
            message(text)


@contextlib.asynccontextmanager
async def tool_keys(
    fleet: FleetConfig, envelope: Envelope, config_dir: Path, as_bridge: str | None
) -> AsyncGenerator[ToolKeys | None]:
    """The keys of a fleet for a tool, fetched once; None where messages are not secured.

    Args:
        fleet: says where keys come from.
        envelope: what `tool_envelope` made.
        config_dir: the folder of `fleet.yaml`.
        as_bridge: the bridge whose certificate the key service is asked with.
    """
    if not fleet.pubsub.is_secured:
        yield None
        return
    async with source_of(fleet, config_dir, as_bridge) as source:
        keys = ToolKeys(envelope, source)
        await keys.refresh()
        yield keys


def source_of(
    fleet: FleetConfig, config_dir: Path, as_bridge: str | None
) -> contextlib.AbstractAsyncContextManager[KeySource]:
    """Where a tool gets keys of a fleet from; raises ConfigError for a bridge that there is not."""
    keys = fleet.pubsub.keys
    if keys.source == "files":
        return contextlib.nullcontext(FileKeySource(config_dir / keys.folder, SecurityPolicy.named(keys.policy)))
    if as_bridge is None or as_bridge not in fleet.bridges:
        raise ConfigError(
            f"there is no bridge {as_bridge!r}", key="bridges", suggestion=f"one of {', '.join(fleet.bridges)}"
        )
    return service_keys_of(fleet, as_bridge, config_dir / fleet.state_dir_of(as_bridge))
