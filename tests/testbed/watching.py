"""A client on the host that stays connected, and notes when which node was Bad: what an operator sees in UaExpert."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import UaFleetError

__all__ = ["Login", "Seen", "Watcher", "addresses_of", "state_of"]

_TIMEOUT_S: Final = 4.0
_AGAIN_S: Final = 0.3
_STATE: Final = ".State"


def state_of(robot: str) -> str:
    """The node of a robot's State."""
    return f"ns=2;s=Robots.{robot}{_STATE}"


@dataclass(frozen=True, slots=True)
class Login:
    """How the client logs in."""

    endpoint: str
    user: str
    password: str
    identity: Path
    """Folder of its certificate, which the server trusts."""


def addresses_of(config: FleetConfig, robots: Iterable[str] | None = None) -> dict[str, str]:
    """The nodes that show whether robots are heard, with the robot of each. What clients write may have no value."""
    found: dict[str, str] = {}
    for name in config.robots if robots is None else robots:
        found[state_of(name)] = name
        for data in config.robots[name].data.values():
            if data.origin == "server":
                continue
            fields = [f"ns=2;s={data.id}.{part}" for part in data.fields or ()]
            found |= dict.fromkeys(fields or [f"ns=2;i={data.id}"], name)
    return found


@dataclass(slots=True)
class Seen:
    """What a client has seen of some nodes. Times are seconds since 1970."""

    addresses: Mapping[str, str]
    """With the robot of each."""
    bad: dict[str, str] = field(default_factory=dict[str, str])
    """Those that are not Good now, or not known to be in this connection, with their quality."""
    troubles: list[tuple[float, str, str]] = field(default_factory=list[tuple[float, str, str]])
    """When something went away: the node, or `connection`, and what was shown."""
    is_connected: bool = False

    def connected(self) -> None:
        """Nothing is known until it is told."""
        self.is_connected = True
        self.bad = dict.fromkeys(self.addresses, "not told yet")

    def lost(self, now: float) -> None:
        """The connection has gone."""
        if self.is_connected:
            self.troubles.append((now, "connection", "lost"))
        self.is_connected = False
        self.bad = dict.fromkeys(self.addresses, "no connection")

    def changed(self, address: str, status: str, now: float) -> None:
        """A node has got a value or a quality."""
        if status == "Good":
            self.bad.pop(address, None)
            return
        if self.bad.get(address) in (None, "not told yet"):
            self.troubles.append((now, address, status))
        self.bad[address] = status

    def is_all_good(self) -> bool:
        """Whether all is as it should be."""
        return self.is_connected and not self.bad

    def good_of(self, robots: Iterable[str]) -> list[str]:
        """The values of some robots that are Good now. Their State is the server's word, and always Good."""
        values = [address for robot in robots for address, of in self.addresses.items() if of == robot]
        return [address for address in values if address not in self.bad and not address.endswith(_STATE)]

    def troubles_of(self, robots: Iterable[str], since: float, until: float) -> list[tuple[str, str]]:
        """The nodes of some robots that went away in a time, and what was shown; the connection is all robots'."""
        names = set(robots)
        if not names:
            return []
        return [
            (address, status)
            for at, address, status in self.troubles
            if since <= at < until and (address == "connection" or self.addresses[address] in names)
        ]

    def noticed_after(self, since: float) -> float | None:
        """Seconds from a moment until the first trouble after it; None where nothing was noticed."""
        return next((at - since for at, _, _ in self.troubles if at >= since), None)


class Watcher:
    """The client."""

    def __init__(self, login: Login, addresses: Mapping[str, str]) -> None:
        """Prepare to watch some nodes, given with the robot of each."""
        self._login, self._addresses = login, addresses
        self.seen = Seen(addresses)
        self.client: FleetClient | None = None
        self._is_there = asyncio.Event()

    async def run(self) -> None:
        """Watch over any number of connections, until cancelled."""
        login = self._login
        while True:
            try:
                async with FleetClient.connect(
                    login.endpoint,
                    user=login.user,
                    password=login.password,
                    identity=ClientIdentity(login.identity),
                    timeout_s=_TIMEOUT_S,
                ) as client:
                    self.seen.connected()
                    self.client = client
                    self._is_there.set()
                    async for change in client.watch(list(self._addresses)):
                        self.seen.changed(change.node_id, change.status_text, time.time())
            except UaFleetError:
                pass  # how long that lasts is what is measured
            finally:
                self.client = None
                self._is_there.clear()
                self.seen.lost(time.time())
            await asyncio.sleep(_AGAIN_S)

    async def connected(self) -> FleetClient:
        """The connected client, once there is one."""
        while self.client is None:
            await self._is_there.wait()
        return self.client
