"""The past of numbers, as the page of a robot asks for it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio

from tests.integration.console.conftest import FLEET
from tests.integration.console.harness import OBSERVER, Browser, Console
from tests.integration.server_model.harness import SPEED, Running, fleet_config, serving
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.values import BuiltinType

BATTERY: Final = "ns=2;i=1005"
SPEED_NODE: Final = f"ns=2;i={SPEED.id}"


@pytest_asyncio.fixture
async def server(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Running]:
    """A server that keeps the values of one robot, and not those of its goal."""
    data = {**FLEET["rover"]["data"]}
    data["goal"] = {**data["goal"], "history": False}
    robots = {"rover": {**FLEET["rover"], "data": data}}
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots=robots, history={})) as running:
        yield running


async def line(browser: Browser, node: str, *, points: int = 100, span_s: float = 60) -> dict[str, Any]:
    answer = await browser.ask("node.trends", nodes=[node], span_s=span_s, points=points)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()["result"]["lines"].get(node, {})
    return found


async def wrote(browser: Browser, *values: float) -> None:
    for value in values:
        answer = await browser.ask("node.write", node=BATTERY, value=str(value))
        assert answer.status_code == 200, answer.text


async def test_few_values_are_those_that_were_kept(console: Console) -> None:
    async with console.logged_in() as browser:
        await wrote(browser, 10, 50, 30)
        async with asyncio.timeout(30):
            while (found := await line(browser, BATTERY)).get("values", [])[-3:] != [10, 50, 30]:
                await asyncio.sleep(0.05)
        assert not found["average"]
        assert found["back"] == sorted(found["back"], reverse=True)
        assert all(back <= 60_000 for back in found["back"])


async def test_many_values_are_averages_of_as_many_intervals_as_asked(console: Console) -> None:
    async with console.logged_in(OBSERVER) as looker, console.logged_in() as browser:
        await wrote(browser, *range(20))
        async with asyncio.timeout(30):
            while not (found := await line(looker, BATTERY, points=5, span_s=10)).get("average"):
                await asyncio.sleep(0.05)
        assert len(found["values"]) == 5
        known = [value for value in found["values"] if value is not None]
        assert all(0 <= value <= 80 for value in known)


async def test_what_is_not_good_is_a_gap(server: Running, console: Console) -> None:
    async with console.logged_in() as browser:
        server.peer.announce(SPEED, (make_field("speed", BuiltinType.DOUBLE),))
        server.peer.publish(SPEED, 0.5)
        # It is silent then, and its node is Bad_NoCommunication.
        async with asyncio.timeout(30):
            while (found := await line(browser, SPEED_NODE)).get("values", [])[-2:] != [0.5, None]:
                await asyncio.sleep(0.1)
        assert not found["average"]


async def test_what_is_not_kept_is_left_out_and_the_feed_says_so(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        assert await line(browser, "ns=2;i=1002") == {}
        assert await line(browser, "ns=2;i=9999") == {}
        await live.want("one", "robot", robot="rover")
        await live.until(lambda: "one" in live.feeds)
        told = {key: one["history"] for key, one in live.feeds["one"].items() if key.startswith("data/")}
        assert (told[f"data/{BATTERY}"], told["data/ns=2;i=1002"]) == (True, False)


@pytest.mark.parametrize("wrong", [{"points": 100_000}, {"span_s": 1e9}, {"nodes": []}, {"nodes": ["i=1"] * 251}])
async def test_more_than_a_page_needs_is_refused(console: Console, wrong: dict[str, Any]) -> None:
    async with console.logged_in() as browser:
        asked: dict[str, Any] = {"nodes": [BATTERY], "span_s": 60, "points": 100, **wrong}
        answer = await browser.ask("node.trends", **asked)
        assert answer.status_code == 400, answer.text
