"""The listening socket: how many connections there may be, and what becomes of those that do not get on."""

from __future__ import annotations

import asyncio
import os
import socket
import time
from typing import Final

import structlog

from ua_fleet.endpoint.admission import Admission, Waiting
from ua_fleet.endpoint.audit import Caller
from ua_fleet.endpoint.connection import TcpConnection
from ua_fleet.endpoint.processor import Processor, Stage, refuse_stranger
from ua_fleet.endpoint.services import Services
from ua_fleet.endpoint.session_keys import KeyFileError
from ua_fleet.endpoint.users import UserFileError
from ua_fleet.errors import ServerStartError
from ua_fleet.transport.addresses import host_and_port

__all__ = ["EndpointListener"]

_log = structlog.get_logger("ua_fleet.server")

_ACCEPTED_AT_ONCE: Final = 32
"""Connections that are accepted before others get their turn."""
_BACKLOG: Final = 1024
"""Connections that the kernel keeps for us: one that it drops is tried again by its client after a second."""


class EndpointListener:
    """Accepts connections, and looks after them once in each tick."""

    def __init__(self, services: Services, host: str, port: int) -> None:
        self._services, self._context = services, services.context
        self._host, self._wanted_port = host, port
        self._server: asyncio.Server | None = None
        self._admission = Admission(self._context.limits.connections)
        self._connections: dict[TcpConnection, Processor] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._housekeeping: asyncio.Task[None] | None = None
        self._generation = self._context.users.generation
        self._users_broken = self._keys_broken = False
        self._bridges = self._bridges_generation()
        self._gateways = self._context.trust.gateways.generation
        self.port = port
        """The port that is listened on; the system's choice where 0 was asked for."""

    async def bind(self) -> None:
        """Take the port, without listening yet; raises ServerStartError."""
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(
                lambda: TcpConnection(self._accept, self._open, self._started),
                self._host,
                self._wanted_port,
                backlog=_ACCEPTED_AT_ONCE,
                start_serving=False,
            )
        except OSError as error:
            raise ServerStartError(
                f"opc.tcp://{host_and_port(self._host, self._wanted_port)}: cannot listen ({error.strerror or error}); "
                f"set server.port (or UA_FLEET__SERVER__PORT) to a free port, server.host to an address of this machine"
            ) from error
        self.port = int(self._server.sockets[0].getsockname()[1])

    async def start(self) -> None:
        """Listen."""
        assert self._server is not None
        await self._server.start_serving()
        for listening in self._server.sockets:
            # asyncio accepts as many at a time as it lets wait; the kernel may keep more.
            with socket.socket(fileno=os.dup(listening.fileno())) as same:
                same.listen(_BACKLOG)
        self._housekeeping = asyncio.create_task(self._keep_house(), name="housekeeping")

    async def stop(self) -> None:
        """Stop listening, close all connections and end all sessions."""
        if self._server is not None:
            self._server.close()
        if self._housekeeping is not None:
            self._housekeeping.cancel()
            await asyncio.wait([self._housekeeping])
        connections = list(self._connections)
        for connection in connections:
            connection.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for connection in connections:
            # Nobody waits for a client that does not read.
            connection.abort()
        for session in self._services.sessions:
            await self._services.session.end(session, delete_subscriptions=True)
        if self._server is not None:
            await self._server.wait_closed()

    def _accept(self, connection: TcpConnection) -> bool:
        """Whether a new connection may stay; one that has no user makes room for it."""
        statistics = self._context.statistics
        statistics.connections += 1
        charges = self._context.charges
        if charges.is_exhausted(connection.address, time.monotonic()):
            refuse_stranger(self._context, connection.peer)
            return False
        if self._admission.has_room(len(self._connections)):
            return True
        waiting = [
            Waiting(other, processor.waiting_as, processor.progress, other.opened_at, processor.is_beside_gateway)
            for other, processor in self._connections.items()
            if processor.stage < Stage.AUTHENTICATED
        ]
        beside_gateway = charges.has_gateway(connection.address)
        closing, may_stay = self._admission.make_room(waiting, len(self._connections), beside_gateway=beside_gateway)
        for other in closing:
            statistics.connections_evicted += 1
            self._connections.pop(other).cut_off("made room for a newer connection", "BadTcpServerTooBusy")
        if not may_stay:
            statistics.connections_refused += 1
            reason = f"there are {self._context.limits.connections} connections with a user"
            self._context.audit.refuse(Caller(connection.peer), "connection", "BadTcpServerTooBusy", reason=reason)
        return may_stay

    def _open(self, connection: TcpConnection) -> Processor:
        processor = self._connections[connection] = Processor(connection, self._services)
        return processor

    def _started(self, connection: TcpConnection, task: asyncio.Task[None]) -> None:
        self._tasks.add(task)
        task.add_done_callback(lambda done: self._forget(connection, done))

    def _forget(self, connection: TcpConnection, task: asyncio.Task[None]) -> None:
        self._connections.pop(connection, None)
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._context.mistakes.caught("connections", error, client=connection.peer)

    async def _keep_house(self) -> None:
        while True:
            # Without this loop nothing would time out any more.
            with self._context.mistakes.guard("housekeeping"):
                await self._tick(time.monotonic())
            await asyncio.sleep(self._context.limits.tick_s)

    async def _tick(self, now: float) -> None:
        used = {id(session.link) for session in self._services.sessions if session.active}
        for connection, processor in list(self._connections.items()):
            with self._context.mistakes.guard("connections", client=processor.peer):
                if id(processor) not in used:
                    processor.fall_back()
                if reason := processor.overdue(now):
                    # Once: what it does may go on for a while, such as the check of a password.
                    del self._connections[connection]
                    processor.cut_off(reason)
        await self._services.session.end_overdue()
        for work in self._context.housekeeping:
            with self._context.mistakes.guard("housekeeping"):
                await work()
        self._context.audit.tick()
        users = self._context.users
        try:
            users.refresh()
            self._users_broken = False
        except UserFileError as error:
            if not self._users_broken:
                self._users_broken = True
                _log.error("users file cannot be used: nobody can log in", reason=str(error))
        if users.generation != self._generation:
            self._generation = users.generation
            await self._services.session.follow_users()
        try:
            self._context.session_keys.refresh()
            self._keys_broken = False
        except KeyFileError as error:
            if not self._keys_broken:
                self._keys_broken = True
                _log.error("file of session keys cannot be used: none of them is valid", reason=str(error))
        await self._services.session.follow_session_keys()
        if (generation := self._bridges_generation()) != self._bridges:
            self._bridges = generation
            await self._services.session.follow_bridges()
        gateways = self._context.trust.gateways
        gateways.refresh()
        if gateways.generation != self._gateways:
            self._gateways = gateways.generation
            for processor in self._connections.values():
                processor.recognise()
            await self._services.session.follow_gateways()

    def _bridges_generation(self) -> int:
        bridges = self._context.bridges
        if bridges is None:
            return 0
        bridges.refresh()
        return bridges.generation
