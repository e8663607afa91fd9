"""The device of an operator who holds a stick: `tab.py SOCKET SETTINGS_JSON`.

It drives through the console's WebSocket as a page does, or by OPC UA. Prints each setpoint before it is sent, as
`wish SENT SEEN LEASE SPEED ECHO`: when, and when it first saw the counter that is echoed. Told what to do as one of

    {"do": "acquire", "by": "console" | "opcua", "take_over": bool}   the lease, and when it was asked for and granted
    {"do": "wish", "speed": float | null, "as": KIND}                 what is wished from now on, each PERIOD_S
    {"do": "forge", "lease": int, "speed": float}                     setpoints under somebody else's lease, by OPC UA
    {"do": "state"}                                                   why the lease is over
    {"do": "release"}

where KIND is `new`; `stale`, the echo of now for ever; `repeated`, the message of now for ever; `queued`, kept until
the next `wish` and then sent at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import sys
import time
from abc import ABC, abstractmethod
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, Final

import httpx
from asyncua import ua
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from tests.teleoperation.programs.control import serve
from ua_fleet.client import ClientIdentity, DrivingLease, FleetClient, driving
from ua_fleet.client.teleoperation import _METHODS  # pyright: ignore[reportPrivateUsage]
from ua_fleet.errors import UaFleetError

PERIOD_S: Final = 0.04
GRANT_S: Final = 8.0
UNDER_WAY: Final = 20
"""Setpoints that may wait for their answers. With more of them a busy server would never come to one that is fresh."""
FORGED: Final = 10


class Refused(Exception):
    """The robot is not given out."""


class Held(ABC):
    """A lease, and what is heard under it."""

    def __init__(self) -> None:
        self.lease = 0
        self.over = ""
        self.counter = 0
        self.seen: dict[int, float] = {}

    def told(self, counter: int) -> None:
        if counter not in self.seen:
            self.seen[counter] = time.monotonic()
            self.counter = counter

    @abstractmethod
    async def send(self, number: int, echo: int, speed: float) -> None:
        """Send a setpoint; what goes wrong ends the lease."""

    @abstractmethod
    async def release(self) -> None:
        """Give it back."""

    @abstractmethod
    async def close(self) -> None:
        """Let everything go at once."""


class ThroughConsole(Held):
    """As the console's page does it."""

    def __init__(self, socket: ClientConnection) -> None:
        super().__init__()
        self._socket = socket
        self._held: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._reading = asyncio.ensure_future(self._read())

    async def acquire(self, first: dict[str, Any]) -> None:
        await self._socket.send(json.dumps(first))
        async with asyncio.timeout(GRANT_S):
            await self._held

    async def _read(self) -> None:
        try:
            async for text in self._socket:
                said = json.loads(text)
                if "held" in said:
                    self.lease = said["held"]["lease"]
                    self.told(said["held"]["counter"])
                    self._held.set_result(None)
                elif "over" in said:
                    self.over = said["over"]["message"]
                elif "counter" in said:
                    self.told(said["counter"])
        except ConnectionClosed as error:
            self.over = self.over or str(error)
        self.over = self.over or f"closed: {self._socket.close_reason}"
        if not self._held.done():
            self._held.set_exception(Refused(self.over))

    async def send(self, number: int, echo: int, speed: float) -> None:
        try:
            # Without waiting for room, as a browser does.
            text = json.dumps({"n": number, "echo": echo, "values": [speed, 0.0]})
            asyncio.ensure_future(self._say(text))  # noqa: RUF006 - it ends with the connection
            await asyncio.sleep(0)
        except ConnectionClosed as error:
            self.over = self.over or str(error)

    async def _say(self, text: str) -> None:
        with contextlib.suppress(ConnectionClosed):
            await self._socket.send(text)

    async def release(self) -> None:
        await self._say(json.dumps({"release": True}))
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(3):
                while not self.over:
                    await asyncio.sleep(0.01)

    async def close(self) -> None:
        self._socket.transport.abort()
        await asyncio.wait([self._reading])
        if self._held.done() and not self._held.cancelled():
            self._held.exception()


class ThroughOpcUa(Held):
    """As an OPC UA client does it; a setpoint does not wait for the answer to the one before."""

    def __init__(self, client: FleetClient, lease: DrivingLease, context: AsyncExitStack) -> None:
        super().__init__()
        self._client, self._driving, self._context = client, lease, context
        self.lease = lease.number
        self.told(lease.counter)
        self._tasks = {asyncio.ensure_future(self._follow())}

    async def _follow(self) -> None:
        lease = self._driving
        while not self.over:
            await lease.changed.wait()
            lease.changed.clear()
            self.told(lease.counter)
            self.over = lease.over

    async def send(self, number: int, echo: int, speed: float) -> None:
        if len(self._tasks) < UNDER_WAY:
            task = asyncio.ensure_future(self._drive(number, echo, speed))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _drive(self, number: int, echo: int, speed: float) -> None:
        try:
            await call_drive(self._client, self._driving.info.node_id, (self.lease, number, echo), speed)
        except UaFleetError as error:
            self.over = self.over or str(error)

    async def release(self) -> None:
        with contextlib.suppress(UaFleetError, TimeoutError):
            async with asyncio.timeout(3):
                await self._driving.release()
        self.over = "released"

    async def close(self) -> None:
        for task in list(self._tasks):
            task.cancel()
        with contextlib.suppress(UaFleetError, OSError, TimeoutError):
            async with asyncio.timeout(3):
                await self._context.aclose()


async def call_drive(client: FleetClient, node_id: str, head: tuple[int, int, int], speed: float) -> None:
    """Drive(Lease, Number, Echo, Values)."""
    numbers = [ua.Variant(value, ua.VariantType.UInt32) for value in head]
    values = ua.Variant([speed, 0.0], ua.VariantType.Double, is_array=True)
    await client.call(node_id, _METHODS["Drive"], *numbers, values)


class Tab:
    """See the module."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._settings = settings
        self._held: Held | None = None
        self._http: httpx.AsyncClient | None = None
        self._csrf = ""
        self._number = 0
        self._speed: float | None = None
        self._kind = "new"
        self._echo = 0
        self._kept: list[tuple[int, int, float]] = []

    async def answer(self, said: dict[str, Any]) -> dict[str, Any]:
        match said["do"]:
            case "acquire":
                return await self._acquire(said["by"], take_over=said.get("take_over", False))
            case "wish":
                await self._wish(said["speed"], said.get("as", "new"))
            case "forge":
                return await self._forge(said["lease"], said["speed"])
            case "release":
                self._speed = None
                if self._held is not None:
                    await self._held.release()
            case "state":
                held = self._held
                return {"over": held.over if held is not None else "nothing was held"}
            case other:
                raise ValueError(other)
        return {"at": time.monotonic()}

    # ------------------------------------------------------------------ the lease

    async def _acquire(self, by: str, *, take_over: bool) -> dict[str, Any]:
        self._speed = None
        if (before := self._held) is not None:
            self._held = None
            await before.close()
        asked = time.monotonic()
        try:
            async with asyncio.timeout(GRANT_S):
                make = self._by_console if by == "console" else self._by_opcua
                self._held = await make(take_over)
        except (Refused, UaFleetError, httpx.HTTPError, OSError, ConnectionClosed, TimeoutError) as error:
            if "log in again" in str(error):  # of logins that a busy machine has not answered each has left a key
                self._http = None
            return {"refused": f"{type(error).__name__}: {error}"}
        self._number = 0
        granted = time.monotonic()
        print("lease", self._held.lease, asked, granted, flush=True)
        return {"lease": self._held.lease, "asked": asked, "granted": granted}

    async def _by_console(self, take_over: bool) -> Held:
        url, settings = self._settings["console"], self._settings
        if self._http is None:
            http = httpx.AsyncClient(base_url=url, headers={"origin": url}, timeout=5)
            fields = {key: settings[key] for key in ("fleet", "user", "password")}
            answer = await http.post("/api/login", json=fields)
            if answer.status_code != 200:
                raise Refused(answer.text)
            self._http, self._csrf = http, answer.json()["csrf"]
        cookie = "; ".join(f"{each.name}={each.value}" for each in self._http.cookies.jar)
        headers = {"origin": url, "cookie": cookie}
        socket = await connect(f"{url.replace('http', 'ws', 1)}/api/drive", additional_headers=headers, proxy=None)
        held = ThroughConsole(socket)
        first = {"csrf": self._csrf, "fleet": settings["fleet"], "robot": settings["robot"], "take_over": take_over}
        try:
            await held.acquire(first)
        except BaseException:
            await held.close()
            raise
        return held

    async def _by_opcua(self, take_over: bool) -> Held:
        async with AsyncExitStack() as stack:
            client = await self._client(stack)
            lease = await stack.enter_async_context(driving(client, self._settings["robot"], take_over=take_over))
            return ThroughOpcUa(client, lease, stack.pop_all())

    async def _client(self, stack: AsyncExitStack) -> FleetClient:
        settings = self._settings
        identity = ClientIdentity(Path(settings["identity"]))
        return await stack.enter_async_context(
            FleetClient.connect(
                settings["server"],
                user=settings["user"],
                password=settings["password"],
                identity=identity,
                timeout_s=GRANT_S,
            )
        )

    async def _forge(self, lease: int, speed: float) -> dict[str, Any]:
        refusals: list[str] = []
        async with AsyncExitStack() as stack:
            client = await self._client(stack)
            for number in range(100_000, 100_000 + FORGED):
                try:
                    await call_drive(client, self._settings["teleoperation"], (lease, number, number), speed)
                except UaFleetError as error:
                    refusals.append(str(error))
        return {"sent": FORGED, "refusals": refusals}

    # ------------------------------------------------------------------ the stick

    async def _wish(self, speed: float | None, kind: str) -> None:
        kept, self._kept = self._kept, []
        held = self._held
        for each in kept:
            if held is not None:
                await held.send(*each)
        self._speed, self._kind = speed, kind
        self._echo = held.counter if held is not None else 0

    async def hold(self) -> None:
        """Hold the stick as it is, for ever."""
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            due = max(due + PERIOD_S, loop.time())
            await asyncio.sleep(due - loop.time())
            held, speed = self._held, self._speed
            if held is None or speed is None or held.over:
                continue
            if self._kind != "repeated":
                self._number += 1
            echo = held.counter if self._kind in ("new", "queued") else self._echo
            print("wish", time.monotonic(), held.seen[echo], held.lease, speed, echo, flush=True)
            if self._kind == "queued":
                self._kept.append((self._number, echo, speed))
            else:
                await held.send(self._number, echo, speed)


async def main() -> None:
    tab = Tab(json.loads(sys.argv[2]))
    holding = asyncio.ensure_future(tab.hold())
    await asyncio.wait([holding, asyncio.ensure_future(serve(sys.argv[1], tab.answer))], return_when="FIRST_COMPLETED")
    holding.result()


if __name__ == "__main__":
    asyncio.run(main())
