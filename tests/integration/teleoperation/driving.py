"""A requestor that drives a robot without an OPC UA server: Actions, setpoints and the bridge's status over PubSub."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from tests.integration.actions.requesting import Requesting, requesting
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.teleoperation import teleoperations
from ua_fleet.skill.executions import OutcomeKind, RequestOutcome, named_results
from ua_fleet.skill.journal import MemoryJournal
from ua_fleet.teleoperation import Setpoint, Status
from ua_fleet.teleoperation.messages import STATUS_FIELDS, encode_setpoint, read_granted, read_status
from ua_fleet.topics import Topic
from ua_fleet.wire import Codec

SEND_PERIOD_S = 0.02
WAIT_S = 60.0
TIMEOUT_S = 5.0


class Driver:
    """Who drives the one robot of a bridge; several of them may share a requestor, as users share a server."""

    def __init__(self, requestor: Requesting, config: FleetConfig, name: str) -> None:
        self.requestor, self.name = requestor, name
        (bridge,) = config.bridges
        (self.model,) = teleoperations(config, bridge)
        self._codec = Codec()
        self.lease = self.number = 0
        self.echo: int | None = None
        """What is echoed in place of the newest counter."""

    @property
    def status(self) -> Status | None:
        """The latest of the bridge."""
        message = self.requestor.status.get(self.model.status)
        if message is None:
            return None
        return read_status({field.name: one for field, one in zip(STATUS_FIELDS, message.values, strict=True)})

    async def ask(self, topic: Topic, *values: Any) -> RequestOutcome:
        """Ask the bridge for something."""
        return await self.requestor.invoke(topic, values, TIMEOUT_S)

    async def acquire(self, *, take_over: bool = False) -> RequestOutcome:
        """Ask for a lease, and keep it where it is granted."""
        outcome = await self.ask(self.model.acquire, self.name, f"session of {self.name}", take_over)
        if outcome.kind is OutcomeKind.ACCEPTED:
            granted = read_granted(named_results(outcome, ()))
            assert granted is not None
            self.lease, _, axes = granted
            assert axes == tuple(name for name, _ in self.model.axes)
            self.number = 0
        return outcome

    async def acquired(self) -> None:
        """Get a lease as soon as the robot can be driven, and hear the first counter under it."""
        commands = self.requestor.commands
        for topic in self.model.actions:
            commands.want(topic)
        async with asyncio.timeout(WAIT_S):
            while None in [commands.action(topic) for topic in self.model.actions]:
                await asyncio.sleep(0.01)
            while (await self.acquire()).kind is not OutcomeKind.ACCEPTED:
                await asyncio.sleep(0.05)
            await self.until(lambda status: status.lease == self.lease)

    async def until(self, is_so: Callable[[Status], bool]) -> Status:
        """Wait until the bridge says something."""
        async with asyncio.timeout(WAIT_S):
            while (status := self.status) is None or not is_so(status):
                await asyncio.sleep(0.005)
        return status

    def send(
        self, linear: float, angular: float = 0.0, *, number: int | None = None, lease: int | None = None
    ) -> float:
        """Send one setpoint; when."""
        self.number = self.number + 1 if number is None else number
        status = self.status
        assert status is not None
        echo = status.counter if self.echo is None else self.echo
        setpoint = Setpoint(self.lease if lease is None else lease, self.number, echo, (linear, angular))
        self.requestor.send(encode_setpoint(self._codec, self.model.setpoints, setpoint))
        return asyncio.get_running_loop().time()

    async def drive(self, seconds: float, linear: float, angular: float = 0.0) -> float:
        """Drive for a time; when the last setpoint was sent."""
        loop = asyncio.get_running_loop()
        until = loop.time() + seconds
        while True:
            sent = self.send(linear, angular)
            await asyncio.sleep(SEND_PERIOD_S)
            if loop.time() >= until:
                return sent


@asynccontextmanager
async def driving(config: FleetConfig, folder: Path, *names: str) -> AsyncGenerator[list[Driver]]:
    """Operators with these names, who share a server's place in PubSub while the context lasts."""
    own = folder / "server"
    own.mkdir()
    async with requesting(config, own, journal=MemoryJournal()) as requestor:
        yield [Driver(requestor, config, name) for name in names]
