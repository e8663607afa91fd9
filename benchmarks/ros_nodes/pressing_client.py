"""The browser of the benchmark `teleoperation`: holds a key, and now and then presses another one.

    pressing_client.py SETTINGS_JSON

stdout: `ready` when it can drive the robot; stdin: `ours COUNT` or `floor COUNT`, answered with a JSON list of pairs,
the monotonic time of each press and the speed that it wishes. What is held is sent each PERIOD_S, a press at once.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import sys
import time
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any, Final

import httpx
from websockets.asyncio.client import connect

PERIOD_S: Final = 0.04
BETWEEN_S: Final = (0.2, 0.3)
"""From press to press: longer than the robot takes from the one speed to the other."""
SPEEDS: Final = (0.2, 0.25)
PATIENCE_S: Final = 40.0
Say = Callable[[float], Awaitable[None]]


class Browser:
    """Somebody who is logged in at the console."""

    def __init__(self, settings: dict[str, Any], http: httpx.AsyncClient, csrf: str) -> None:
        self._settings, self._http, self._csrf = settings, http, csrf
        self._counter = self._number = 0

    @asynccontextmanager
    async def driving(self) -> AsyncGenerator[Say]:
        """Hold the robot while the context lasts."""
        url = self._settings["console"]
        cookie = "; ".join(f"{each.name}={each.value}" for each in self._http.cookies.jar)
        address, headers = f"{url.replace('http', 'ws', 1)}/api/drive", {"origin": url, "cookie": cookie}
        async with connect(address, additional_headers=headers, proxy=None, compression=None) as socket:
            await socket.send(json.dumps({"csrf": self._csrf, "fleet": "floor", "robot": "carrier"}))
            said = json.loads(await socket.recv())
            if "held" not in said:
                raise RuntimeError(said)
            self._counter, self._number = said["held"]["counter"], 0

            async def follow() -> None:
                async for text in socket:
                    said = json.loads(text)
                    self._counter = said.get("counter", self._counter)
                    if "over" in said:
                        raise RuntimeError(said["over"])

            async def say(speed: float) -> None:
                if following.done():
                    following.result()
                self._number += 1
                await socket.send(json.dumps({"n": self._number, "echo": self._counter, "values": [speed, 0.0]}))

            following = asyncio.ensure_future(follow())
            try:
                yield say
            finally:
                following.cancel()
                with contextlib.suppress(asyncio.CancelledError, RuntimeError):
                    await following


@asynccontextmanager
async def bare(port: int) -> AsyncGenerator[Say]:
    """The same at the floor."""
    async with connect(f"ws://127.0.0.1:{port}", proxy=None, compression=None) as socket:
        yield lambda speed: socket.send(repr(speed))


async def press(say: Say, count: int) -> list[tuple[float, float]]:
    """Press so many times; when, and for which speed."""
    presses: list[tuple[float, float]] = []
    await hold(say, SPEEDS[0], 0.6)
    for number in range(count):
        speed = SPEEDS[(number + 1) % 2]
        presses.append((time.monotonic(), speed))
        await hold(say, speed, random.uniform(*BETWEEN_S))
    await hold(say, 0.0, 0.6)
    return presses


async def hold(say: Say, speed: float, seconds: float) -> None:
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        await say(speed)
        await asyncio.sleep(min(PERIOD_S, left))


async def main(settings: dict[str, Any]) -> None:
    url = settings["console"]
    async with httpx.AsyncClient(base_url=url, headers={"origin": url}, timeout=PATIENCE_S) as http:
        login = {"fleet": "floor", "user": settings["user"], "password": settings["password"]}
        answer = await http.post("/api/login", json=login)
        answer.raise_for_status()
        browser = Browser(settings, http, answer.json()["csrf"])
        async with asyncio.timeout(PATIENCE_S):
            while True:
                try:
                    async with browser.driving() as say:
                        await hold(say, 0.0, 1.0)
                        break
                except RuntimeError:
                    await asyncio.sleep(0.2)
        print("ready", flush=True)
        while line := (await asyncio.to_thread(sys.stdin.readline)).split():
            async with browser.driving() if line[0] == "ours" else bare(settings["floor"]) as say:
                print(json.dumps(await press(say, int(line[1]))), flush=True)


asyncio.run(main(json.loads(sys.argv[1])))
