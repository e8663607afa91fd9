"""One disturbance: what is noticed, how long healing takes, and what becomes of the commands meanwhile."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

from tests.testbed.clients import modbus_client
from tests.testbed.commands import Commands
from tests.testbed.disturb import ABSENCE_S, Deed, Kind, disturbance
from tests.testbed.engine import CommandFailed, Container
from tests.testbed.ledger import Account, Command, account
from tests.testbed.scenes import GATEWAY, Scene
from tests.testbed.watching import Watcher, state_of
from tests.testbed.words import begun_in
from ua_fleet.client import FleetClient
from ua_fleet.errors import UaFleetError
from ua_fleet.fleet.model import RobotState

__all__ = ["LIMIT_S", "Healing", "Row", "settle"]

LIMIT_S: Final = 60.0
"""Where healing takes longer, something needs help."""
_LOOK_S: Final = 0.25
_GAPS: Final = re.compile(r"^ua_fleet_sequence_gaps_total (\S+)", re.MULTILINE)
_OF_SERVER: Final = ("without the server", "the server is back")
"""What the conductor says when the server goes, and when it comes."""
_METRICS: Final = """
import urllib.request
print(urllib.request.urlopen("http://127.0.0.1:9464/metrics", timeout=5).read().decode())
"""


@dataclass(slots=True)
class Row:
    """What a disturbance has done."""

    kind: str
    service: str
    deed: str
    noticed_s: float | None
    """From its begin until a client saw something; None: nobody noticed anything."""
    healed_s: float | None
    """From its end until all was well; None: not within the limit."""
    missing: list[str] = field(default_factory=list[str])
    """What was not well at the limit."""
    gaps: int | None = None
    """DataSetMessages that the server has missed by their sequence numbers; None: its counters were lost with it."""
    meanwhile: list[str] = field(default_factory=list[str])
    """What was not as it has to be while it lasted."""
    account: Account = field(default_factory=Account)
    since: float = 0.0
    until: float = 0.0


class Healing:
    """Does disturbances, one after the other."""

    def __init__(
        self, scene: Scene, watcher: Watcher, commands: Commands, containers: dict[str, Container], modbus_port: int
    ) -> None:
        """Prepare.

        Args:
            scene: what is up.
            watcher: a client that is connected.
            commands: which are asked for meanwhile.
            containers: of all services.
            modbus_port: of the Modbus server on this machine.
        """
        self._scene, self._watcher, self._commands, self._containers = scene, watcher, commands, containers
        self._modbus_port = modbus_port

    async def disturb(self, kind: Kind, deed: Deed) -> Row:
        """Do it, and wait until all is well again."""
        gaps_before = await self._gaps()
        since = time.time()
        self._commands.begin()
        await asyncio.sleep(2.0)
        act = await asyncio.to_thread(disturbance, deed, self._containers[kind.service], kind.state)
        begun = time.time()
        await asyncio.to_thread(act.begin)
        if deed is not Deed.KILL:
            await asyncio.sleep(max(0.0, begun + ABSENCE_S - time.time()))
        silenced = () if deed is Deed.KILL else kind.silenced
        meanwhile = await self._not_silenced(silenced)
        ended = begun if deed is Deed.KILL else time.time()
        await asyncio.to_thread(act.end)
        missing, healed_s = await self._until_well(kind, ended)
        meanwhile += self._not_spared(kind, begun, ended)
        await self._commands.stop()
        gaps = await self._gaps()
        noticed = self._watcher.seen.noticed_after(begun)
        return Row(
            kind.name,
            kind.service,
            deed.value,
            noticed,
            healed_s,
            missing,
            None if gaps is None or gaps_before is None or gaps < gaps_before else gaps - gaps_before,
            meanwhile,
            since=since,
            until=time.time(),
        )

    async def _not_silenced(self, robots: Sequence[str]) -> list[str]:
        """What is still Good of robots that nobody hears, and which of them is not said to be away."""
        found = [f"{address} was Good at the end of it" for address in self._watcher.seen.good_of(robots)]
        if not robots:
            return found
        client = self._watcher.client
        if client is None:
            return [*found, "no connection at the end of it"]
        readings = await client.read([state_of(robot) for robot in robots])
        shown = zip(robots, readings, strict=True)
        return found + [f"{robot} was not offline" for robot, read in shown if read.value != RobotState.OFFLINE]

    def _not_spared(self, kind: Kind, begun: float, ended: float) -> list[str]:
        """What has befallen robots that a disturbance does not concern, while it lasted."""
        seen = self._watcher.seen
        found = [f"{address} was {status}" for address, status in seen.troubles_of(kind.spared, begun, ended)]
        if ended > begun:
            idle = [robot for robot in kind.spared if not self._commands.done_between(robot, begun, ended)]
            found += [f"{robot} did nothing meanwhile" for robot in idle]
        return found

    async def _until_well(self, kind: Kind, since: float) -> tuple[list[str], float | None]:
        while True:
            missing = await self._missing(kind, since)
            now = time.time()
            if not missing:
                return [], now - since
            if now - since > LIMIT_S:
                return missing, None
            await asyncio.sleep(_LOOK_S)

    async def _missing(self, kind: Kind, since: float) -> list[str]:
        """What is not well; what costs more is asked only where nothing else is missing."""
        seen = self._watcher.seen
        if not seen.is_all_good():
            return [f"{address} is {status}" for address, status in list(seen.bad.items())[:5]] or ["no connection"]
        # Each of them: one that is a service works where what the bridge publishes reaches nobody.
        not_done = [
            f"{robot}.{skill} was not done" for robot in kind.robots for skill in self._commands.not_done(robot, since)
        ]
        if not_done:
            return not_done
        client = self._watcher.client
        if client is None:
            return ["no connection"]
        try:
            old = await self._not_told_since(client, kind.robots, since)
        except UaFleetError as error:
            return [str(error)]
        if old:
            return old
        problems = await asyncio.gather(
            *(asyncio.to_thread(_health_problem, self._containers[name]) for name in (kind.service, *kind.also))
        )
        found = [problem for problem in problems if problem]
        conductor = self._scene.conductor
        if conductor in (kind.service, *kind.also):
            found += await asyncio.to_thread(_conductor_problem, self._containers[conductor])
        if not found and GATEWAY in (kind.service, *kind.also):
            found += await asyncio.to_thread(modbus_client, self._modbus_port)
        return found

    async def _not_told_since(self, client: FleetClient, robots: Sequence[str], since: float) -> list[str]:
        addresses = [address for robot in robots for address in self._scene.telling.get(robot, ())]
        if not addresses:
            return []
        readings = await client.read(addresses)
        return [
            f"nothing new at {reading.node_id}"
            for reading in readings
            if reading.source_time is None or reading.source_time.timestamp() <= since
        ]

    async def _gaps(self) -> int | None:
        try:
            text = await asyncio.to_thread(self._containers[self._scene.server].python, _METRICS)
        except CommandFailed:
            return None
        found = _GAPS.search(text)
        return None if found is None else int(float(found[1]))


def _health_problem(container: Container) -> str | None:
    """What the health check of `compose.yaml` says now; the engine itself asks only now and then."""
    test = container.inspect()["Config"]["Healthcheck"]["Test"]
    try:
        container.execute(*test[1:])
    except CommandFailed as error:
        return f"{container.service}: {str(error).splitlines()[-1]}"
    return None


def _conductor_problem(container: Container) -> list[str]:
    """Its last word of the server, where that has gone."""
    said = [line for line in container.logs().splitlines() if line.startswith(_OF_SERVER)]
    return [f"{container.service}: {line}" for line in said[-1:] if line.startswith(_OF_SERVER[0])]


def settle(scene: Scene, rows: Sequence[Row], commands: Sequence[Command], containers: dict[str, Container]) -> None:
    """Fill in what has become of the commands of each row, once nothing is under way any more."""
    if not rows:
        return
    begun = begun_in(containers, scene.conductor, scene.controllers, rows[0].since, time.time())
    for row in rows:
        row.account = account(
            [command for command in commands if row.since <= command.asked_at < row.until],
            [one for one in begun if row.since <= one.at < row.until],
        )
