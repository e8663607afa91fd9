"""A page that drives a robot over `api/drive`, as far as its WebSocket shows."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any, Final

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from tests.integration.console.harness import Browser

__all__ = ["Driving", "drive"]

WAIT_S: Final = 60.0


@dataclass
class Driving:
    """A page that drives, as far as its WebSocket shows."""

    socket: ClientConnection
    held: dict[str, Any] = field(default_factory=dict[str, Any])
    state: dict[str, Any] = field(default_factory=dict[str, Any])
    over: dict[str, Any] = field(default_factory=dict[str, Any])
    counter: int = 0
    number: int = 0
    echo: int | None = None
    """What is echoed in place of the newest counter."""
    is_patient: bool = False
    """Whether it wishes again only when the server has sent the last wish on, so that none overtakes another."""

    async def say(self, **said: Any) -> None:
        await self.socket.send(json.dumps(said))

    async def wish(self, *values: float, number: int | None = None, echo: int | None = None) -> None:
        self.number = self.number + 1 if number is None else number
        await self.say(n=self.number, echo=echo or self.echo or self.counter, values=values)

    def take(self, text: str | bytes) -> None:
        message = json.loads(text)
        if "held" in message:
            self.held = message["held"]
            self.counter = self.held["counter"]
        elif "over" in message:
            self.over = message["over"]
        else:
            self.state = message
            self.counter = message["counter"]

    async def until(self, is_so: Callable[[], Any], wish: tuple[float, ...] | None = (0.0, 0.0)) -> None:
        """Take messages, and wish something each 50 ms, until something is so."""
        async with asyncio.timeout(WAIT_S):
            sent_at = 0.0
            while not is_so():
                may_wish = not self.is_patient or self.state.get("answered", 0) >= self.number
                if wish is not None and may_wish and time.monotonic() - sent_at >= 0.05:
                    sent_at = time.monotonic()
                    await self.wish(*wish)
                try:
                    async with asyncio.timeout(0.05):
                        self.take(await self.socket.recv())
                except TimeoutError:
                    continue

    async def closed(self, wish: tuple[float, ...] | None = None) -> int:
        """Take what comes until it is closed; by which code."""
        try:
            await self.until(lambda: False, wish)
        except ConnectionClosed:
            # What was said before the close waits to be read.
            try:
                while True:
                    self.take(await self.socket.recv())
            except ConnectionClosed:
                pass
        return int(self.socket.close_code or 0)


@asynccontextmanager
async def drive(
    browser: Browser, robot: str = "carrier", *, fleet: str = "hall", **more: Any
) -> AsyncGenerator[Driving]:
    """Acquire a robot; it is held, or refused."""
    headers = {"origin": browser.console.origin, "cookie": browser.cookie, **more.pop("headers", {})}
    url = browser.console.url.replace("http", "ws", 1) + "api/drive"
    async with connect(url, additional_headers=headers) as socket:
        page = Driving(socket)
        async with asyncio.timeout(WAIT_S):
            with contextlib.suppress(ConnectionClosed):  # it was refused
                await page.say(**{"csrf": browser.csrf, "fleet": fleet, "robot": robot, **more})
                while not page.held and not page.over:
                    page.take(await socket.recv())
        yield page
