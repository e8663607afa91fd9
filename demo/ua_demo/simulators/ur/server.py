"""The sockets and the clock of a simulated controller."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, Self

from ua_demo.simulators.ur.controller import PERIOD_S, Controller, Settings
from ua_demo.simulators.ur.dashboard import GREETING, Dashboard
from ua_demo.simulators.ur.functions import functions_of
from ua_demo.simulators.ur.packets import log_message, realtime_packet, robot_state, version_message
from ua_demo.simulators.ur.provoking import Provoking
from ua_demo.simulators.ur.rtde import ProtocolError, RtdeInputs, RtdeSession
from ua_demo.simulators.ur.urscript import ProgramReceiver

__all__ = ["Ports", "UrSimulator"]

_READ_BYTES: Final = 65_536
_MOST_UNREAD: Final = 262_144
"""Bytes that wait for a client; what does not fit is left out, as a controller does with a client that reads slowly."""
_LEAST_GAP_S: Final = 0.0005
"""A cycle that is late is made up for, but no closer to the one before: a real controller sends at an even pace."""
_MOST_LATE_S: Final = 0.1
"""So late the clock goes on from now: the machine was away."""
_STATE_EVERY: Final = 50
"""Cycles between two robot states for primary and secondary clients: 10 Hz."""
_MOST_AT_ONCE: Final = 25
"""Cycles that are made up for in one turn while nothing happens in them: to wake for each costs more than all else."""


@dataclass(frozen=True)
class Ports:
    """TCP ports. ur-rtde always takes the usual ones; several controllers on a machine have addresses of their own."""

    dashboard: int = 29999
    primary: int = 30001
    secondary: int = 30002
    realtime: int = 30003
    rtde: int = 30004
    provoking: int = 30005

    def shifted(self, offset: int) -> Ports:
        """All of them higher by so much."""
        numbers = (self.dashboard, self.primary, self.secondary, self.realtime, self.rtde, self.provoking)
        return Ports(*[number + offset for number in numbers])


@dataclass(eq=False)
class _Client:
    """A connection that is sent something by itself."""

    writer: asyncio.StreamWriter
    kind: str
    rtde: RtdeSession | None = None

    def send(self, data: bytes) -> None:
        transport = self.writer.transport
        if data and not transport.is_closing() and transport.get_write_buffer_size() < _MOST_UNREAD:
            self.writer.write(data)


class UrSimulator:
    """One controller. `async with` it."""

    def __init__(self, settings: Settings, host: str, ports: Ports) -> None:
        self.controller = Controller(settings, functions_of)
        self._host, self._ports = host, ports
        self._inputs = RtdeInputs()
        self._provoking = Provoking(self.controller, self._drop, self._silence)
        self._clients: set[_Client] = set()
        self._servers: list[asyncio.Server] = []
        self._silent: str | None = None
        """Which kind of client is not answered, the empty text for all; None: each is."""
        self._cycle = 0
        self._due = 0.0
        """When the last cycle was due."""
        self._woken: asyncio.Future[bool] | None = None
        self._logged = 0.0

    async def __aenter__(self) -> Self:
        serving = (
            (self._ports.dashboard, self._serve_dashboard),
            (self._ports.primary, self._serving_scripts("primary")),
            (self._ports.secondary, self._serving_scripts("secondary")),
            (self._ports.realtime, self._serving_scripts("realtime")),
            (self._ports.rtde, self._serve_rtde),
            (self._ports.provoking, self._serve_provoking),
        )
        for port, serve in serving:
            self._servers.append(await asyncio.start_server(serve, self._host, port))
        return self

    async def __aexit__(self, *_: object) -> None:
        for server in self._servers:
            server.close()
        self._drop()

    async def run(self) -> None:
        """The clock: a cycle each 2 ms, none left out."""
        loop = asyncio.get_running_loop()
        self._due = loop.time()
        while True:
            due = self._due + PERIOD_S * self._calm_cycles()
            late = loop.time() - due
            if late > _MOST_LATE_S:
                self._due = due = loop.time()
            if await self._slept(max(-late, _LEAST_GAP_S)):
                self.controller.jitter_s = max(loop.time() - due, 0.0)
                self._catch_up(due + PERIOD_S / 2)

    async def _slept(self, seconds: float) -> bool:
        """Sleep; whether it was not ended by something that came in."""
        self._woken = asyncio.get_running_loop().create_future()
        timer = asyncio.get_running_loop().call_later(seconds, self._wake, True)
        try:
            return await self._woken
        finally:
            timer.cancel()

    def _wake(self, as_planned: bool) -> None:
        if self._woken is not None and not self._woken.done():
            self._woken.set_result(as_planned)

    def _calm_cycles(self) -> int:
        """Cycles until one, itself included, in which something may happen or is sent."""
        if not self.controller.is_at_rest or any(client.kind == "realtime" for client in self._clients):
            return 1
        sending = [client.rtde.cycles_until_due(self._cycle) for client in self._clients if client.rtde is not None]
        return min([_MOST_AT_ONCE - self._cycle % _MOST_AT_ONCE, *sending])

    def _catch_up(self, until: float) -> None:
        """Do the cycles that were due before."""
        while self._due + PERIOD_S < until:
            self._due += PERIOD_S
            self._step()

    def _something_comes(self) -> None:
        """Be where the clock is, and have it go on with single cycles."""
        if self.controller.is_at_rest:
            self._catch_up(min(asyncio.get_running_loop().time(), self._due + PERIOD_S * _MOST_AT_ONCE))
            self._wake(False)

    def _step(self) -> None:
        controller = self.controller
        controller.step()
        self._cycle += 1
        if self._silent == "" or not self._clients:
            return
        realtime = state = b""
        said = self._new_log() if self._cycle % _STATE_EVERY == 0 else b""
        for client in self._clients:
            if client.rtde is not None:
                client.send(client.rtde.due(self._cycle))
            elif client.kind == "realtime":
                realtime = realtime or realtime_packet(controller)
                client.send(realtime)
            elif client.kind in ("primary", "secondary") and self._cycle % _STATE_EVERY == 0:
                state = state or robot_state(controller)
                client.send(state + said if client.kind == "primary" else state)

    def _new_log(self) -> bytes:
        lines = [line for line in self.controller.log if line.time > self._logged]
        self._logged = self.controller.time
        return b"".join(log_message(line) for line in lines)

    # Connections

    def _is_silent(self, kind: str) -> bool:
        return self._silent in ("", kind)

    async def _read(self, reader: asyncio.StreamReader, kind: str) -> bytes:
        """What came in; nothing of it is answered while the controller is silent."""
        data = await reader.read(_READ_BYTES)
        while self._is_silent(kind) and data:
            data = await reader.read(_READ_BYTES)
        self._something_comes()
        return data

    async def _talk(
        self, reader: asyncio.StreamReader, client: _Client, greeting: bytes, take: Callable[[bytes], bytes]
    ) -> None:
        """Serve a client until it or the controller ends."""
        self._clients.add(client)
        try:
            if not self._is_silent(client.kind):
                client.writer.write(greeting)
            while data := await self._read(reader, client.kind):
                answer = take(data)
                if answer and client.writer.transport.get_write_buffer_size() > _MOST_UNREAD:
                    raise ValueError("it asks, and reads no answers")
                client.writer.write(answer)  # not drained: ur-rtde never reads what port 30003 sends
        except (OSError, ProtocolError, ValueError) as error:
            self.controller.say("info", f"a {client.kind} client was sent away: {error}")
        finally:
            self._clients.discard(client)
            client.writer.close()
            with suppress(OSError):
                await client.writer.wait_closed()

    async def _serve_dashboard(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        dashboard = Dashboard(self.controller)

        def take(data: bytes) -> bytes:
            answer = dashboard.receive(data)
            if dashboard.is_over:
                reader.feed_eof()
            return answer

        await self._talk(reader, _Client(writer, "dashboard"), f"{GREETING}\n".encode(), take)

    async def _serve_rtde(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        session = RtdeSession(self.controller, self._inputs)
        try:
            await self._talk(reader, _Client(writer, "rtde", session), b"", session.receive)
        finally:
            session.close()

    def _serving_scripts(self, kind: str) -> Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]:
        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            receiver = ProgramReceiver()

            def take(data: bytes) -> bytes:
                for source in receiver.feed(data):
                    self._start_script(source)
                return b""

            greeting = b"" if kind == "realtime" else version_message(self.controller)
            await self._talk(reader, _Client(writer, kind), greeting, take)

        return serve

    def _start_script(self, source: str) -> None:
        if not self.controller.remote_control:
            self.controller.say("exception", "a program was not started: the robot is in local control")
        elif source.strip() != "run program":  # what some clients send after a program, since CB2
            self.controller.start_script(source)

    async def _serve_provoking(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async for line in reader:
                self._something_comes()
                writer.write(self._provoking.answer(line.decode("utf-8", "replace")).encode() + b"\n")
                await writer.drain()
        except (OSError, ValueError) as error:
            self.controller.say("info", f"a provoking client was sent away: {error}")
        finally:
            writer.close()

    def _drop(self) -> None:
        for client in self._clients:
            client.writer.transport.abort()

    def _silence(self, on: bool, kind: str) -> None:
        self._silent = kind if on else None
