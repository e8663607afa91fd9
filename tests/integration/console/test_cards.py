"""What `fleet.yaml` marks for the card of a robot, in front of a real server."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping
from pathlib import Path
from typing import Any, Final

import pytest_asyncio

from tests.integration.console.harness import Console
from tests.integration.server_model.harness import ROBOTS, Running, fleet_config, serving

_BATTERY: Final = {"id": 1005, "type": "Double", "unit": "%", "origin": "server", "initial": 80}
_ARM: Final = {
    "id": 1006,
    "origin": "server",
    "fields": {"x": {"type": "Double", "unit": "m", "initial": 1.5}, "mode": {"type": "String", "initial": "<b>slow"}},
}
_DATA: Final[Mapping[str, Any]] = {
    "battery": _BATTERY,
    "arm": _ARM,
    "load": {"id": 1007, "type": "Double", "unit": "kg"},
}


@pytest_asyncio.fixture
async def server(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Running]:
    """A server with one robot that has a card."""
    robot = {**ROBOTS["rover"], "data": _DATA, "card": ["arm.x", "load", "arm.mode"]}
    async with serving(tmp_path, fleet_config(udp_url, tcp_port, robots={"rover": robot})) as running:
        yield running


async def test_a_card_has_what_is_marked_in_its_order(console: Console) -> None:
    async with console.logged_in() as browser, browser.live() as live:
        await live.want("all", "robots")
        await live.until(lambda: len(live.feeds.get("all", {}).get("rover", {}).get("marked", ())) == 3)
        x, load, mode = live.feeds["all"]["rover"]["marked"]
        assert (x["name"], x["v"], x["u"], x["s"]) == ("arm.x", 1.5, "m", 0)
        assert (load["name"], load["u"]) == ("load", "kg")
        assert load["s"] >> 30 == 2, "no value of its robot has come"
        assert (mode["name"], mode["v"]) == ("arm.mode", "<b>slow")
        assert (await browser.ask("node.write", node="ns=2;s=1006.x", value="2")).status_code == 200
        await live.until(lambda: live.feeds["all"]["rover"]["marked"][0]["v"] == 2)
        assert (await browser.ask("node.write", node="ns=2;s=1006.mode", value="m" * 9999)).status_code == 200
        await live.until(lambda: live.feeds["all"]["rover"]["marked"][2]["v"] == "m" * 200 + "…")
        read = (await browser.ask("node.read", node="ns=2;s=Robots.rover.Card")).json()["result"]
        assert read["value"]["v"] == ["ns=2;s=1006.x", "ns=2;i=1007", "ns=2;s=1006.mode"]
