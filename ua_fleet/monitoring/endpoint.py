"""The HTTP side: `/healthz`, `/readyz` and `/metrics`, in the event loop that they tell of.

A blocked event loop answers nobody, which is the answer. Connections are few, each is for one request, and the oldest
makes room for a new one, so that whoever opens many and says nothing keeps nobody else from asking. h11 reads what
comes; what is no HTTP is answered with 400 where it can be, and costs a closed connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import os
import secrets
import socket
from collections.abc import Sequence
from http import HTTPStatus
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

import h11
import structlog

from ua_fleet.errors import ServerStartError
from ua_fleet.monitoring.address import remove_address, write_address
from ua_fleet.monitoring.lag import LoopLag
from ua_fleet.monitoring.monitor import Monitor

__all__ = ["INSTANCE_HEADER", "MonitoringEndpoint"]

INSTANCE_HEADER: Final = "Ua-Fleet-Instance"
MOST_CONNECTIONS: Final = 32
PATIENCE_S: Final = 5.0
"""A client has so long for its request and for taking the answer."""
_MOST_REQUEST_BYTES: Final = 8192
_TEXT: Final = "text/plain; charset=utf-8"

_log: Any = structlog.get_logger("ua_fleet.monitoring")


class _Answer(NamedTuple):
    status: int
    body: bytes
    content_type: str = _TEXT
    allow: str = ""


class MonitoringEndpoint:
    """Listens while the context lasts."""

    def __init__(
        self, monitor: Monitor, host: str, port: int, state_dir: Path, *, key: str, names: Sequence[str] = ()
    ) -> None:
        """Make an endpoint.

        Args:
            monitor: is asked.
            host: address to listen on.
            port: TCP port; 0 takes any free one.
            state_dir: folder for the file with the address.
            key: the key of `fleet.yaml` that the port stands in, for an error's remedy.
            names: by which it may be asked, besides addresses, `localhost`, `host` and the machine's own name.
        """
        self._monitor, self._host, self._wanted_port, self._state_dir, self._key = monitor, host, port, state_dir, key
        own = ("localhost", host, socket.gethostname(), *names)
        self._names = frozenset(name.lower().removesuffix(".") for name in own)
        self._instance = secrets.token_hex(8)
        self._server: asyncio.Server | None = None
        self._open: dict[asyncio.Task[None], None] = {}
        """The oldest first."""
        self._lag = LoopLag(monitor.lagged)
        self.port = port
        """The port that is listened on."""

    async def __aenter__(self) -> Self:
        """Listen; raises ServerStartError."""
        try:
            self._server = await asyncio.start_server(
                self._serve, self._host, self._wanted_port, limit=_MOST_REQUEST_BYTES, backlog=MOST_CONNECTIONS
            )
        except OSError as error:
            place = _place(self._host, self._wanted_port)
            reason = os.strerror(error.errno).lower() if error.errno and error.errno > 0 else str(error)
            raise ServerStartError(
                f"health and metrics cannot be served at {place} ({reason}); set {self._key} to a free port or 0, and "
                f"monitoring.host to an address of this machine"
            ) from error
        self.port = int(self._server.sockets[0].getsockname()[1])
        _log.info("health and metrics", url=f"http://{_place(self._host, self.port)}")
        try:
            write_address(self._state_dir, self._host, self.port, self._instance)
        except OSError as error:
            _log.warning("monitoring.json cannot be written", folder=str(self._state_dir), reason=error.strerror)
        self._lag.start()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close all connections, and listen no more."""
        self._lag.stop()
        remove_address(self._state_dir, self._instance)
        if self._server is not None:
            self._server.close()
        tasks = list(self._open)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        if self._server is not None:
            await self._server.wait_closed()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        if len(self._open) >= MOST_CONNECTIONS:
            oldest = next(iter(self._open))
            del self._open[oldest]
            oldest.cancel()
        self._open[task] = None
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._exchange(reader, writer)
        except (OSError, TimeoutError, asyncio.CancelledError, h11.ProtocolError):
            pass  # whatever the client did, there is nothing to do for it
        except Exception as error:  # noqa: BLE001 - nobody waits for this task
            self._monitor.mistakes.caught("monitoring", error)
        finally:
            self._open.pop(task, None)
            writer.transport.abort()

    async def _exchange(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Read one request, and answer it."""
        connection = h11.Connection(h11.SERVER, max_incomplete_event_size=_MOST_REQUEST_BYTES)
        is_head = False
        try:
            while not isinstance(event := connection.next_event(), h11.Request):
                if event is not h11.NEED_DATA:
                    return  # it has closed
                connection.receive_data(await reader.read(_MOST_REQUEST_BYTES))
            is_head = event.method == b"HEAD"
            try:
                answer = self._answer(event)
            except Exception as error:  # noqa: BLE001 - whoever asks is told that there is no answer
                self._monitor.mistakes.caught("monitoring", error)
                answer = _Answer(500, b"a mistake; see the log\n")
        except h11.RemoteProtocolError as error:
            answer = _Answer(error.error_status_hint, b"this is no request that can be answered here\n")
        writer.write(self._bytes(connection, answer, is_head=is_head))
        await writer.drain()
        # An answer is complete once the client has closed too: what it still sends would reset the connection.
        writer.write_eof()
        with contextlib.suppress(OSError):
            while await reader.read(_MOST_REQUEST_BYTES):
                pass

    def _answer(self, request: h11.Request) -> _Answer:
        if request.method not in (b"GET", b"HEAD"):
            return _Answer(405, b"only GET and HEAD\n", allow="GET, HEAD")
        if not self._is_meant(request):
            return _Answer(421, b"this process has no such name; monitoring.names in fleet.yaml says which it has\n")
        path = request.target.partition(b"?")[0]
        if path == b"/healthz":
            return _Answer(200, f"{self._monitor.alive_text()}\n".encode())
        if path == b"/readyz":
            if problem := self._monitor.problem():
                return _Answer(503, f"not ready: {problem}\n".encode())
            return _Answer(200, f"{self._monitor.ready_text()}\n".encode())
        if path == b"/metrics":
            accepted = next((value for name, value in request.headers if name == b"accept"), b"")
            body, content_type = self._monitor.exposition(accepted.decode("latin-1"))
            return _Answer(200, body, content_type)
        return _Answer(404, b"there are /healthz, /readyz and /metrics\n")

    def _is_meant(self, request: h11.Request) -> bool:
        """Whether the request names this process (RFC 9110 7.2).

        A web page whose name its owner lets lead here, once it runs in a browser on this machine, still asks by that
        name. Addresses are as good as ours: nobody can give them another meaning.
        """
        named = next((value for name, value in request.headers if name == b"host"), None)
        if named is None:  # HTTP/1.0, which no browser speaks
            return True
        host = named.decode("latin-1").strip().lower()
        host = host[1:].partition("]")[0] if host.startswith("[") else host.rpartition(":")[0] or host
        with contextlib.suppress(ValueError):
            ipaddress.ip_address(host)
            return True
        return host.removesuffix(".") in self._names

    def _bytes(self, connection: h11.Connection, answer: _Answer, *, is_head: bool) -> bytes:
        headers = [
            ("Content-Type", answer.content_type),
            ("Content-Length", str(len(answer.body))),
            ("Connection", "close"),
            ("Cache-Control", "no-store"),
            (INSTANCE_HEADER, self._instance),
        ]
        if answer.allow:
            headers.append(("Allow", answer.allow))
        reason = HTTPStatus(answer.status).phrase.encode()
        sent = connection.send(h11.Response(status_code=answer.status, headers=headers, reason=reason)) or b""
        if not is_head:
            sent += connection.send(h11.Data(data=answer.body)) or b""
        return sent + (connection.send(h11.EndOfMessage()) or b"")


def _place(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
