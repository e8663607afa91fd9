"""The listening socket: how many connections there may be, and what becomes of those that do not get on."""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import asyncio
import time

import structlog

from ua_fleet.errors import ServerStartError
from ua_fleet.server.audit import Caller
from ua_fleet.server.endpoint.connection import Connection
from ua_fleet.server.endpoint.processor import Processor, Services, Stage
from ua_fleet.server.users import UserFileError

__all__ = ["Listener"]

_log = structlog.get_logger("ua_fleet.server")


class Listener:
    """Accepts connections, and looks after them once in each tick."""

    def __init__(self, services: Services, host: str, port: int) -> None:
        self._services, self._context = services, services.context
        self._host, self._wanted_port = host, port
        self._server: asyncio.Server | None = None
        self._connections: dict[Connection, Processor] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._housekeeping: asyncio.Task[None] | None = None
        self._generation = self._context.users.generation
        self._users_broken = False
        self._bridges = self._bridges_generation()
        self.port = port
        """The port that is listened on; the system's choice where 0 was asked for."""

    async def bind(self) -> None:
        """Take the port, without listening yet; raises ServerStartError."""
        loop = asyncio.get_running_loop()
        try:
            self._server = await loop.create_server(
                lambda: Connection(self._accept, self._open, self._started),
                self._host,
                self._wanted_port,
                start_serving=False,
            )
        except OSError as error:
            raise ServerStartError(
                f"opc.tcp://{self._host}:{self._wanted_port}: cannot listen ({error.strerror or error}); "
                f"set server.port (or UA_FLEET__SERVER__PORT) to a free port, server.host to an address of this machine"
            ) from error
        self.port = int(self._server.sockets[0].getsockname()[1])

    async def start(self) -> None:
        """Listen."""
        assert self._server is not None
        await self._server.start_serving()
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

    def _accept(self, connection: Connection) -> bool:
        """Whether a new connection may stay; the oldest that has not authenticated makes room for it."""
        statistics = self._context.statistics
        statistics.connections += 1
        limit = self._context.limits.connections
        waiting = [other for other, processor in self._connections.items() if processor.stage < Stage.AUTHENTICATED]
        if len(self._connections) >= limit or len(waiting) >= max(1, limit // 2):
            if not waiting:
                statistics.connections_refused += 1
                reason = f"there are {limit} connections"
                self._context.audit.refuse(Caller(connection.peer), "connection", "BadTcpServerTooBusy", reason=reason)
                return False
            statistics.connections_evicted += 1
            self._connections.pop(waiting[0]).cut_off("made room for a newer connection")
        return True

    def _open(self, connection: Connection) -> Processor:
        processor = self._connections[connection] = Processor(connection, self._services)
        return processor

    def _started(self, connection: Connection, task: asyncio.Task[None]) -> None:
        self._tasks.add(task)
        task.add_done_callback(lambda done: self._forget(connection, done))

    def _forget(self, connection: Connection, task: asyncio.Task[None]) -> None:
        self._connections.pop(connection, None)
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("connection failed", client=connection.peer, exc_info=error)

    async def _keep_house(self) -> None:
        while True:
            try:
                await self._tick(time.monotonic())
            except Exception:  # noqa: BLE001 - logged with its traceback
                # Without this loop nothing would time out any more.
                _log.exception("housekeeping failed")
            await asyncio.sleep(self._context.limits.tick_s)

    async def _tick(self, now: float) -> None:
        for processor in list(self._connections.values()):
            if reason := processor.overdue(now):
                processor.cut_off(reason)
        await self._services.session.end_overdue()
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
        if (generation := self._bridges_generation()) != self._bridges:
            self._bridges = generation
            await self._services.session.follow_bridges()

    def _bridges_generation(self) -> int:
        bridges = self._context.bridges
        if bridges is None:
            return 0
        bridges.refresh()
        return bridges.generation
