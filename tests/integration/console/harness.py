"""A console in the test's event loop, in front of a real server, and a browser's part of the conversation."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import httpx
from websockets.asyncio.client import ClientConnection, connect

from tests.integration.server_model.harness import ENGINEER, OBSERVER, OPERATOR
from ua_fleet.console.page import Page
from ua_fleet.console.run import run_console
from ua_fleet.console.settings import ConsoleSettings

__all__ = ["ENGINEER", "NO_TLS", "OBSERVER", "OPERATOR", "Console", "Live", "console_at"]

NO_TLS: Final = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""For clients of plain HTTP: it trusts nobody. Without it httpx reads 140 certificates for each client, 0.02 s."""

PAGE: Final = "<!doctype html><title>console</title>"


@dataclass
class Console:
    """A console that runs."""

    url: str
    cookies: dict[str, str] = field(default_factory=dict[str, str])

    @property
    def origin(self) -> str:
        return self.url.rstrip("/")

    def browser(self) -> httpx.AsyncClient:
        """A browser that keeps cookies, and says where its requests come from."""
        return httpx.AsyncClient(base_url=self.url, headers={"origin": self.origin}, timeout=30, verify=NO_TLS)

    @asynccontextmanager
    async def logged_in(self, user: tuple[str, str] = OPERATOR, fleet: str = "hall") -> AsyncGenerator[Browser]:
        """A browser in which somebody is logged in."""
        async with self.browser() as client:
            answer = await client.post("api/login", json={"fleet": fleet, "user": user[0], "password": user[1]})
            assert answer.status_code == 200, answer.text
            yield Browser(self, client, answer.json())


@dataclass
class Browser:
    """A browser in which somebody is logged in."""

    console: Console
    http: httpx.AsyncClient
    me: dict[str, Any]

    @property
    def csrf(self) -> str:
        return str(self.me["csrf"])

    async def ask(self, operation: str, fleet: str = "hall", **parameters: Any) -> httpx.Response:
        return await self.http.post(f"api/{fleet}/{operation}", json=parameters, headers={"x-csrf": self.csrf})

    @property
    def cookie(self) -> str:
        return "; ".join(f"{cookie.name}={cookie.value}" for cookie in self.http.cookies.jar)

    @asynccontextmanager
    async def live(self, **headers: str) -> AsyncGenerator[Live]:
        url = self.console.url.replace("http", "ws", 1) + "api/live"
        given = {"origin": self.console.origin, "cookie": self.cookie, **headers}
        async with connect(url, additional_headers=given, max_size=None) as socket:
            await socket.send(json.dumps({"csrf": self.csrf}))
            yield Live(socket)


class Live:
    """What a page knows: its feeds' maps, put together as the contract says."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.feeds: dict[str, dict[str, Any]] = {}
        self.errors: dict[str, Any] = {}
        self.links: dict[str, Any] = {}
        self.wholes: dict[str, int] = {}
        self.messages = 0

    @property
    def events(self) -> list[dict[str, Any]]:
        """What the feed `events` has told, without what became of the history."""
        return [one for key, one in self.feeds["events"].items() if key != "history"]

    async def say(self, **said: Any) -> None:
        await self.socket.send(json.dumps(said))

    async def want(self, name: str, feed: str, fleet: str = "hall", **parameters: Any) -> None:
        await self.say(want={name: {"fleet": fleet, "feed": feed, "parameters": parameters}})

    async def step(self, *, confirm: bool = True) -> Mapping[str, Any]:
        """Take one message, and confirm it."""
        message = json.loads(await self.socket.recv())
        self.messages += 1
        self.links.update(message.get("links", {}))
        for name, told in message["feeds"].items():
            if told.get("whole"):
                self.feeds[name] = {}
                self.wholes[name] = self.wholes.get(name, 0) + 1
            if told.get("error"):
                self.errors[name] = told["error"]
            elif "error" in told:
                self.errors.pop(name, None)
            if "set" in told:
                self.feeds[name].update(told["set"])
            for key, part in told.get("part", {}).items():
                self.feeds[name][key] = self.feeds[name][key] | part
            for key in told.get("gone", ()):
                self.feeds[name].pop(key, None)  # it may have come and gone meanwhile
        if confirm:
            await self.say(seen=message["n"])
        return dict(message)

    async def until(self, expected: Callable[[], Any], timeout_s: float = 60) -> None:
        """Take messages until something is so."""
        try:
            async with asyncio.timeout(timeout_s):
                while not expected():
                    await self.step()
        except TimeoutError:
            raise AssertionError(f"feeds {self.feeds}, errors {self.errors}, links {self.links}") from None


@asynccontextmanager
async def console_at(folder: Path, endpoints: Mapping[str, str], **settings: Any) -> AsyncGenerator[Console]:
    """A console for fleets, given by their endpoints, while the context lasts; its end is clean."""
    page = folder / "page"
    (page / "assets").mkdir(parents=True, exist_ok=True)
    (page / "index.html").write_text(PAGE)
    (page / "assets" / "app-1234.js").write_text("// a script\n" * 200)
    given = ConsoleSettings.model_validate(
        {
            "listen": "127.0.0.1:0",
            "fleets": {name: {"endpoint": one} for name, one in endpoints.items()},
            "state_dir": folder / "console",
            **settings,
        }
    )
    ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    task = asyncio.ensure_future(run_console(given, ready=ready.set_result, page=Page(page)))
    waited: list[asyncio.Future[Any]] = [task, ready]
    await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED, timeout=20)
    if not ready.done():
        task.result()
    try:
        yield Console(ready.result())
        assert not task.done(), task.exception()
    finally:
        task.cancel()
        await asyncio.wait([task])
