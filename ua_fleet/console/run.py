"""The console as a process: the sockets that it listens on, uvicorn, and an end in order."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import tempfile
from collections.abc import AsyncGenerator, Callable, Coroutine, Generator
from functools import partial
from typing import Any

import uvicorn

from ua_fleet.console import connections
from ua_fleet.console.app import ConsoleApp
from ua_fleet.console.connections import BoundedListener, Connections, bounded_http, bounded_websocket
from ua_fleet.console.counts import ConsoleCounts
from ua_fleet.console.figures import console_figures
from ua_fleet.console.identity import console_identity
from ua_fleet.console.origins import TrustedProxies
from ua_fleet.console.page import Page
from ua_fleet.console.people import People
from ua_fleet.console.sessions import cookie_name
from ua_fleet.console.settings import ConsoleSettings, TlsFiles, default_state_dir, split_listen
from ua_fleet.errors import ServerStartError
from ua_fleet.monitoring import Monitor, ProcessKind
from ua_fleet.monitoring.endpoint import MonitoringEndpoint

__all__ = ["run_console"]


class _Quiet(uvicorn.Server):
    """uvicorn without its own handling of signals: whoever runs the console cancels it."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self.begun = asyncio.Event()

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Begin to answer, and say so."""
        await super().startup(sockets)
        self.begun.set()

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None]:
        yield


async def run_console(
    settings: ConsoleSettings, *, ready: Callable[[str], object] = lambda _url: None, page: Page | None = None
) -> None:
    """Serve until cancelled; then people are logged out of their servers, and nothing is left.

    Args:
        settings: checked.
        ready: called with the URL once it answers.
        page: the page's files; by default those of the package.

    Raises:
        ServerStartError: the address is in use or not ours, or the certificate cannot be used.
    """
    host, port = split_listen(settings.listen)
    context = _tls(settings.tls) if settings.tls is not None else None
    monitor = Monitor(ProcessKind.CONSOLE)
    counts = ConsoleCounts(monitor.mistakes)
    proxies = TrustedProxies(settings.trusted_proxies)
    there = Connections(proxies, settings.limits.connections_per_address, counts)
    listening = _listening(host, port, there)
    identity = console_identity(settings.state_dir or default_state_dir())
    try:
        await identity.ensure()
        async with _monitored(settings, monitor), asyncio.TaskGroup() as group:

            def spawn(work: Coroutine[Any, Any, None], what: str) -> asyncio.Task[None]:
                return group.create_task(_guarded(work, what, counts), name=what)

            people = People(settings, identity, counts, spawn)
            cookie = cookie_name(identity.certificate.read_bytes(), listening.getsockname()[1])
            app = ConsoleApp(settings, people, counts, cookie, page, there)
            monitor.add(partial(console_figures, people, app, counts))
            server = _Quiet(_uvicorn(settings, app, counts, context))
            sweeping = spawn(people.sweep(), "sweep")
            serving = group.create_task(server.serve([listening]), name="uvicorn")
            try:
                await server.begun.wait()
                monitor.ready_when(str)
                ready(_url(settings, listening))
                await asyncio.shield(serving)
            finally:
                server.should_exit = True
                sweeping.cancel()
                await people.close()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(1.0):
                        await asyncio.wait([serving])
    finally:
        listening.close()


@contextlib.asynccontextmanager
async def _monitored(settings: ConsoleSettings, monitor: Monitor) -> AsyncGenerator[None]:
    if settings.monitoring_port is None:
        yield
        return
    state_dir = settings.state_dir or default_state_dir()
    key = "monitoring_port"
    async with MonitoringEndpoint(monitor, "127.0.0.1", settings.monitoring_port, state_dir, key=key, names=()):
        yield


async def _guarded(work: Coroutine[Any, Any, None], what: str, counts: ConsoleCounts) -> None:
    try:
        await work
    except Exception as error:  # noqa: BLE001  (one task, one mistake)
        counts.mistake(what, error)


def _listening(host: str, port: int, there: Connections) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = BoundedListener(family, socket.SOCK_STREAM)
    made.connections = there
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        made.listen(128)
    except OSError as error:
        made.close()
        raise ServerStartError(
            f"the console cannot listen at {host}:{port}: {error.strerror}; choose another with --listen"
        ) from error
    made.setblocking(False)
    return made


def _url(settings: ConsoleSettings, listening: socket.socket) -> str:
    host, _ = split_listen(settings.listen)
    port = listening.getsockname()[1]
    shown = settings.allowed_hosts[0] if settings.allowed_hosts and not settings.is_loopback else host
    shown = f"[{shown}]" if ":" in shown and not shown.startswith("[") else shown
    return f"{'https' if settings.tls else 'http'}://{shown}:{port}/"


def _uvicorn(
    settings: ConsoleSettings, app: ConsoleApp, counts: ConsoleCounts, context: ssl.SSLContext | None
) -> uvicorn.Config:
    logging.getLogger("uvicorn").setLevel(logging.WARNING)
    limits = settings.limits
    config = uvicorn.Config(
        app.asgi,
        loop="none",
        http=bounded_http(counts),
        ws=bounded_websocket(counts),
        ws_max_size=limits.message_bytes,
        ws_ping_interval=connections.PING_S,
        ws_ping_timeout=connections.PONG_S,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=limits.connections,
        timeout_keep_alive=15,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=32_768,
    )
    if context is not None:

        def made(_config: uvicorn.Config, _default: Callable[[], ssl.SSLContext]) -> ssl.SSLContext:
            return context

        config.ssl_context_factory = made
    return config


def _tls(files: TlsFiles) -> ssl.SSLContext:
    """TLS by a certificate in PEM or, as `ua-fleet cert create` makes it, in DER."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        content = files.certificate.read_bytes()
        if not content.lstrip().startswith(b"-----BEGIN"):
            content = ssl.DER_cert_to_PEM_cert(content).encode()
        with tempfile.NamedTemporaryFile(suffix=".pem") as pem:  # ssl reads files alone
            pem.write(content)
            pem.flush()
            context.load_cert_chain(pem.name, files.key)
    except (OSError, ssl.SSLError, ValueError) as error:
        raise ServerStartError(
            f"the console cannot use {files.certificate} with {files.key}: {error}; they belong together, and the key "
            "has no password"
        ) from error
    return context
