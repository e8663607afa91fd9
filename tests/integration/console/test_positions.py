"""Where robots are: found by the names of their data, with places, and never as of now when it is not."""

from __future__ import annotations

import json
import math
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio

from tests.integration.console.harness import OPERATOR, Console, console_at
from tests.integration.server_model.harness import POSE, ROBOTS, Running, fleet_config, serving
from ua_fleet.config.load import load_content
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType

DOUBLE, STRING = BuiltinType.DOUBLE, BuiltinType.STRING
CART: Final = Topic(POSE.space, 2, 1104)
PLACES: Final = {"gate": [9, 9], "dock <b>": [4, -2.5]}
FLEET: Final[Any] = {
    **ROBOTS,
    "cart": {
        "bridge": "mobile_side",
        "data": {
            "odom": {
                "id": CART.id,
                "fields": {
                    "pose.pose.position.x": {"type": "Double", "unit": "mm"},
                    "pose.pose.position.y": {"type": "Double", "unit": "mm"},
                    "pose.pose.orientation.z": {"type": "Double"},
                    "pose.pose.orientation.w": {"type": "Double"},
                },
            }
        },
    },
    "press": {
        "bridge": "mobile_side",
        "data": {
            "position": {
                "id": 1204,
                "origin": "server",
                "fields": {
                    "x": {"type": "Double", "unit": "m", "initial": 7},
                    "y": {"type": "Double", "unit": "m", "initial": 1},
                    "heading": {"type": "Double", "unit": "deg", "initial": 90},
                },
            }
        },
    },
    "oven": {
        "bridge": "mobile_side",
        "data": {"pose": {"id": 1304, "fields": {"x": {"type": "Double", "unit": "°C"}}}},
    },
}


@pytest_asyncio.fixture
async def server(tmp_path: Path, udp_url: str, tcp_port: int) -> AsyncGenerator[Running]:
    raw: dict[str, Any] = fleet_config(udp_url, tcp_port, robots=FLEET).model_dump(mode="json", exclude_unset=True)
    distance = {"x": "position.x", "y": "position.y", "argument": "to", "places": PLACES}
    raw["fleet"]["places"] = {"yard": [1, 1], "gate": [0, 0]}
    raw["resilience"] = {"criteria": {"distance": {"kind": "cost", "range": [0, 20], "distance": distance}}}
    config = load_content(json.dumps(raw).encode(), "fleet.json", {}, allow_missing_ids=True)
    async with serving(tmp_path, config) as running:
        yield running


@pytest_asyncio.fixture
async def console(server: Running, tmp_path: Path) -> AsyncGenerator[Console]:
    async with console_at(tmp_path, {"hall": server.url}) as running:
        yield running


async def test_robots_say_where_they_are(server: Running, console: Console) -> None:
    peer = server.peer
    async with console.logged_in(OPERATOR) as browser, browser.live() as live:
        await live.want("map", "positions")
        await live.until(lambda: "map" in live.feeds)
        seen = live.feeds["map"]
        assert {key for key in seen if key.startswith("place/")} == {"place/gate", "place/dock <b>", "place/yard"}
        assert (seen["place/dock <b>"]["x"], seen["place/dock <b>"]["y"]) == (4, -2.5)
        assert {key for key in seen if key.startswith("robot/")} == {"robot/cart", "robot/press"}
        assert (seen["place/gate"]["x"], seen["place/gate"]["y"]) == (0, 0)
        press = seen["robot/press"]
        assert (press["x"], press["y"], press["s"]) == (7, 1, 0)
        assert press["heading"] == pytest.approx(math.pi / 2)
        assert seen["robot/cart"]["x"] is None
        assert seen["robot/cart"]["s"] >= 0x8000_0000
        names = ("position.x", "position.y", "orientation.z", "orientation.w")
        peer.announce(CART, tuple(make_field(f"pose.pose.{name}", DOUBLE) for name in names))
        peer.publish(CART, 1500.0, -250.0, 1.0, 0.0)
        await live.until(lambda: live.feeds["map"]["robot/cart"]["x"] == 1.5)
        cart = live.feeds["map"]["robot/cart"]
        assert (cart["y"], cart["s"]) == (-0.25, 0)
        assert abs(cart["heading"]) == pytest.approx(math.pi)
        peer.mute()
        await live.until(lambda: live.feeds["map"]["robot/cart"]["s"] >= 0x8000_0000)
        assert live.feeds["map"]["robot/cart"]["x"] == 1.5
        assert live.feeds["map"]["fleet"] == {"too_large": False, "most": 1000}
        answer = await browser.ask("node.write", node="ns=2;s=1204.x", value="8")
        assert answer.status_code == 200, answer.text
        await live.until(lambda: live.feeds["map"]["robot/press"]["x"] == 8)
