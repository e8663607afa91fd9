"""Connections with which nothing is done: bounded for each address, cut after a time, and nobody else waits."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
from collections import Counter
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from uvicorn._types import ASGISendEvent
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode

from tests.integration.console.harness import Browser, Console, console_at
from tests.integration.server_model.harness import Running
from ua_fleet.console import run
from ua_fleet.endpoint.certificates import CertificateFiles, create_certificate

Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def port_of(console: Console) -> int:
    return int(console.origin.rpartition(":")[2])


async def drops(browser: Browser) -> dict[str, int]:
    counted: dict[str, int] = (await browser.http.get("healthz")).json()["drops"]
    return counted


async def is_over(reader: asyncio.StreamReader) -> bool:
    """Whether the other side has closed; what it still sends is taken."""
    with contextlib.suppress(ConnectionError):
        async with asyncio.timeout(10):
            while await reader.read(65_536):
                pass
    return True


def upgrade(console: Console, cookie: str = "") -> bytes:
    """The request of a WebSocket."""
    return (
        f"GET /api/live HTTP/1.1\r\nHost: {console.origin.partition('//')[2]}\r\nOrigin: {console.origin}\r\n"
        "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nCookie: {cookie}\r\n\r\n"
    ).encode()


async def test_web_sockets_without_a_login_count_for_their_address(
    server: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are told why, and the other side may leave it at that."""
    monkeypatch.setattr("ua_fleet.console.connections.CLOSED_S", 1.0)
    async with (
        console_at(tmp_path, {"hall": server.url}, limits={"connections_per_address": 4}) as console,
        console.logged_in() as browser,
        browser.live() as live,
    ):
        await live.until(lambda: live.links)
        opened: list[Streams] = []
        for _ in range(3):  # the browser has kept one connection open; that of its WebSocket does not count
            reader, writer = await asyncio.open_connection("127.0.0.1", port_of(console))
            opened.append((reader, writer))
            writer.write(upgrade(console))
            assert b" 101 " in await reader.readline()
        refused, writer = await asyncio.open_connection("127.0.0.1", port_of(console))
        opened.append((refused, writer))
        assert await is_over(refused)
        assert (await drops(browser))["too_many_connections"] == 1
        for reader, _ in opened:
            assert await is_over(reader), "who never confirms that it is closed is cut"
        reader, writer = await asyncio.open_connection("127.0.0.1", port_of(console))
        opened.append((reader, writer))
        writer.write(upgrade(console))
        assert b" 101 " in await reader.readline()
        await live.want("all", "robots")
        await live.until(lambda: "all" in live.feeds)
        for _, writer in opened:
            writer.close()


async def test_a_connection_counts_before_tls_has_begun(server: Running, tmp_path: Path) -> None:
    files = CertificateFiles(tmp_path / "console.der", tmp_path / "console-key.pem")
    create_certificate(files, application_uri="urn:test:console", common_name="localhost")
    tls = {"certificate": str(files.certificate), "key": str(files.private_key)}
    limits = {"connections_per_address": 3}
    async with console_at(tmp_path, {"hall": server.url}, tls=tls, limits=limits) as console:
        mute = [await asyncio.open_connection("127.0.0.1", port_of(console)) for _ in range(3)]
        refused, refused_writer = await asyncio.open_connection("127.0.0.1", port_of(console))
        assert await is_over(refused)
        _, first = mute[0]
        first.write(b"no TLS at all\r\n\r\n")  # which ends it, without a word to any protocol of HTTP
        assert await is_over(mute[0][0])
        first.close()
        reader, writer = await asyncio.open_connection("127.0.0.1", port_of(console))
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await reader.read(1)
        for one in (refused_writer, writer, *(one for _, one in mute)):
            one.close()


@asynccontextmanager
async def deaf(console: Console) -> AsyncGenerator[socket.socket]:
    """A connection whose other side takes next to nothing."""
    with socket.socket() as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        made.setblocking(False)
        await asyncio.get_running_loop().sock_connect(made, ("127.0.0.1", port_of(console)))
        yield made


async def test_an_answer_that_nobody_takes_is_given_up(
    console: Console, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ua_fleet.console.connections.TAKEN_S", 0.5)
    page = tmp_path / "page"
    (page / "assets" / "large.bin").write_bytes(bytes(30_000_000))
    (page / "index.html").write_text("the page was built anew")
    async with console.logged_in() as browser, deaf(console) as made:
        request = f"GET /assets/large.bin HTTP/1.1\r\nHost: {console.origin.partition('//')[2]}\r\n\r\n"
        await asyncio.get_running_loop().sock_sendall(made, request.encode())

        async def is_cut() -> bool:
            return (await drops(browser)).get("too_slow") == 1

        async with asyncio.timeout(20):
            while not await is_cut():
                await asyncio.sleep(0.1)


def masked(said: object) -> bytes:
    return Frame(Opcode.TEXT, json.dumps(said).encode()).serialize(mask=True)


LARGE = {
    "fleet": "hall",
    "feed": "nodes",
    "parameters": {"nodes": [f"ns=2;s={node}.{'x' * 4000}" for node in range(12)]},
}


@pytest.fixture
def _small_buffers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Little finds room between a console and a browser that takes nothing."""
    started: Any = run
    listening = started._listening

    def small(*given: Any) -> socket.socket:
        made: socket.socket = listening(*given)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        return made

    monkeypatch.setattr(started, "_listening", small)


@pytest.mark.usefixtures("_small_buffers")
@pytest.mark.parametrize("what", ["no answer to a ping", "a logout"])
async def test_a_page_that_takes_nothing_is_given_up(
    server: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """It confirms what it has not taken, so that the console goes on sending."""
    if what == "no answer to a ping":
        monkeypatch.setattr("ua_fleet.console.connections.PING_S", 2.0)
        monkeypatch.setattr("ua_fleet.console.connections.PONG_S", 1.0)
    else:
        monkeypatch.setattr("ua_fleet.console.connections.CLOSED_S", 0.5)
    said = WebSocketsSansIOProtocol.send
    waiting: Counter[int] = Counter()
    """How many messages wait to be sent, by the port of whoever is to have them."""

    async def sent(self: WebSocketsSansIOProtocol, message: ASGISendEvent) -> None:
        port = int(self.transport.get_extra_info("peername")[1])
        waiting[port] += 1
        await said(self, message)
        waiting[port] -= 1

    monkeypatch.setattr(WebSocketsSansIOProtocol, "send", sent)
    async with (
        console_at(tmp_path, {"hall": server.url}) as console,
        console.logged_in() as browser,
        console.logged_in() as other,
        other.live() as live,
        deaf(console) as made,
    ):
        await live.say(want={"large": LARGE})
        await live.until(lambda: "large" in live.feeds)
        loop = asyncio.get_running_loop()
        await loop.sock_sendall(made, upgrade(console, browser.cookie))
        assert b" 101 " in await loop.sock_recv(made, 1024)
        await loop.sock_sendall(made, masked({"csrf": browser.csrf}))
        for number in range(10):
            await loop.sock_sendall(made, masked({"want": {f"large-{number}": LARGE}, "seen": number}))
            await asyncio.sleep(0.1)
        async with asyncio.timeout(20):
            while not waiting[made.getsockname()[1]]:
                await asyncio.sleep(0.05)
        if what == "a logout":
            await browser.http.post("api/logout", json={}, headers={"x-csrf": browser.csrf})

        async def sockets() -> int:
            return int((await other.http.get("healthz")).json()["sockets"])

        async with asyncio.timeout(20):
            while await sockets() > 1:
                await asyncio.sleep(0.1)
        assert (await drops(other))["too_slow"] == 1
