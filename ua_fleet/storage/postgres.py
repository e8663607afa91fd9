"""One PostgreSQL database of one server: its connection, its lock, and what can be wrong with it, said with the remedy.

asyncpg needs an event loop, and a store of history is used from a thread of its own: so the loop is that thread's. A
connection that failed in any way is given up, since nobody knows what of the last commit was done; the next work makes
another one, and `prepare` reads again what is known of the store.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Generator
from typing import Any, Final, TypeAlias, TypeVar
from urllib.parse import urlsplit

import asyncpg  # type: ignore[import-untyped]  # pyright: ignore[reportMissingTypeStubs]

from ua_fleet.errors import StorageAway, StorageUnavailable

__all__ = ["TENDING_S", "Connection", "PostgresDatabase"]

CONNECT_S: Final = 10.0
ANSWER_S: Final = 20.0
"""What a commit or a page may take, against a network that swallows all; the end of the process waits for it."""
TENDING_S: Final = 300.0
"""What removing and compacting may take."""
_LOCK: Final = 0x7561_666C_6565_7401
"""Of the advisory lock of a server on a database."""
_LOCK_WAIT_S: Final = 3.0
"""How long the end of a session that still has it is waited for: PostgreSQL notices a kill within milliseconds."""
_KEEP_ALIVE: Final = {"tcp_keepalives_idle": "10", "tcp_keepalives_interval": "5", "tcp_keepalives_count": "3"}
"""So that PostgreSQL gives the lock free within 25 s when the network to a server is gone."""

Done = TypeVar("Done")
Connection: TypeAlias = Any
"""An `asyncpg.Connection`, whose annotations are not complete."""


class PostgresDatabase:
    """A database that this process alone uses. Every method raises StorageUnavailable, and belongs to one thread."""

    def __init__(
        self, url: str, user: str, password: str | None, prepare: Callable[[Connection], Awaitable[None]]
    ) -> None:
        """Connect, and take the lock.

        Args:
            url: `postgresql://host:port/database`.
            user: there.
            password: of that user; None where PostgreSQL asks for none.
            prepare: done on each new connection, before all else.
        """
        self._url, self._user, self._password, self._prepare = url, user, password, prepare
        parts = urlsplit(url)
        self.name = f"PostgreSQL {parts.hostname}:{parts.port or 5432}{parts.path}"
        """Of the database, for messages."""
        self._database_name = parts.path.lstrip("/")
        self._connection: Connection | None = None
        self._loop = asyncio.new_event_loop()
        try:
            self.run(_nothing)
        except BaseException:
            self._loop.close()
            raise

    def run(self, work: Callable[[Connection], Awaitable[Done]], within_s: float = ANSWER_S) -> Done:
        """Do work on the connection, on another one where that is lost."""
        with self._errors():
            return self._loop.run_until_complete(asyncio.wait_for(self._run(work), within_s))

    def close(self) -> None:
        """Give the database free. Safe to call twice."""
        connection, self._connection = self._connection, None
        if self._loop.is_closed():
            return
        if connection is not None:
            with contextlib.suppress(Exception):  # the process ends, or the database is gone: both free the lock
                self._loop.run_until_complete(connection.close(timeout=2))
        self._loop.close()

    async def _run(self, work: Callable[[Connection], Awaitable[Done]]) -> Done:
        # The loop stood still since the last work: a connection that was lost meanwhile is noticed now.
        await asyncio.sleep(0)
        connection = self._connection
        if connection is None or connection.is_closed():
            connection = self._connection = await self._connect()
        return await work(connection)

    async def _connect(self) -> Connection:
        connection: Connection = await asyncpg.connect(
            self._url,
            user=self._user,
            password=self._password,
            timeout=CONNECT_S,  # pyright: ignore[reportArgumentType]
            server_settings={"application_name": "ua-fleet history", "synchronous_commit": "on", **_KEEP_ALIVE},
        )
        try:
            await self._take_lock(connection)
            await self._prepare(connection)
        except BaseException:
            connection.terminate()
            raise
        return connection

    async def _take_lock(self, connection: Connection) -> None:
        until = self._loop.time() + _LOCK_WAIT_S
        while not await connection.fetchval("SELECT pg_try_advisory_lock($1)", _LOCK):
            if self._loop.time() > until:
                raise StorageUnavailable(
                    f"{self.name} is in use by another server; stop that one, or name another database in history.store"
                )
            await asyncio.sleep(0.1)

    @contextlib.contextmanager
    def _errors(self) -> Generator[None]:
        try:
            yield
        except BaseException as error:
            if self._connection is not None:
                self._connection.terminate()
                self._connection = None
            if isinstance(error, _FAILURES):
                kind = StorageAway if isinstance(error, _AWAY) else StorageUnavailable
                raise kind(self._said(error)) from error
            raise

    def _said(self, error: Exception) -> str:
        """One line: what is wrong, and what to do."""
        reason = " ".join(str(error).split()) or type(error).__name__
        for kinds, text in _MEANINGS:
            if isinstance(error, kinds):
                return f"{self.name}: " + text.format(reason=reason, user=self._user, database=self._database_name)
        return f"{self.name}: {reason}; look at its log"


async def _nothing(_connection: Connection) -> None:
    """For a connection alone."""


_FAILURES: Final = (
    asyncpg.PostgresError,
    asyncpg.InterfaceError,
    asyncpg.InternalClientError,  # the connection broke while asyncpg was in the middle of something
    OSError,
    TimeoutError,
)
_AWAY: Final = (asyncpg.CannotConnectNowError, asyncpg.PostgresConnectionError, OSError, TimeoutError)
"""Those that pass without anybody changing the configuration."""
_MEANINGS: Final[tuple[tuple[tuple[type[Exception], ...], str], ...]] = (
    (
        (asyncpg.InvalidAuthorizationSpecificationError,),  # and a wrong password, which is one of it
        "{reason}; look at history.user and history.password_file",
    ),
    ((asyncpg.InvalidCatalogNameError,), "{reason}; make it: createdb --owner {user} {database}"),
    ((asyncpg.DiskFullError,), "its disk is full; free some space there"),
    ((asyncpg.ReadOnlySQLTransactionError,), "it is read only ({reason}); name the primary server in history.store"),
    (
        (asyncpg.InsufficientPrivilegeError,),
        "{reason}; let the user make a schema: GRANT CREATE ON DATABASE {database} TO {user}",
    ),
    ((asyncpg.DataCorruptedError, asyncpg.IndexCorruptedError), "it is broken ({reason}); restore a backup of it"),
    (
        (asyncpg.CannotConnectNowError, asyncpg.PostgresConnectionError, *_FAILURES[1:3]),
        "the connection is lost ({reason}); see whether PostgreSQL runs",
    ),
    ((OSError, TimeoutError), "it cannot be reached ({reason}); see whether PostgreSQL runs there"),
)
