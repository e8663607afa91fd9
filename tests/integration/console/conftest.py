from __future__ import annotations

from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest
import pytest_asyncio

from tests import system
from tests.integration.console.harness import Console, console_at
from tests.integration.scenarios.conftest import Plant
from tests.integration.server_model.harness import ROBOTS, Running, fleet_config, serving
from tests.system import Processes

GOTO: Final[Mapping[str, Any]] = {
    "id": 1600,
    "needs": ["mobile"],
    "arguments": {
        "x": {"type": "Double", "unit": "m", "range": [-5, 5], "default": 0, "description": "east"},
        "gently": {"type": "Boolean", "default": False},
    },
    "results": {"distance": {"type": "Double", "unit": "m"}},
    "timeout_s": 30,
}
BATTERY: Final[Mapping[str, Any]] = {"id": 1005, "type": "Double", "unit": "%", "origin": "server", "initial": 80}
_DATA: Final = {**ROBOTS["rover"]["data"], "battery": BATTERY}
FLEET: Final[Mapping[str, Any]] = {
    "rover": {**ROBOTS["rover"], "data": _DATA, "skill_status_id": 1500, "skills": {"goto": GOTO}}
}


@asynccontextmanager
async def rover_server(folder: Path) -> AsyncGenerator[Running]:
    """A server with one robot, while the context lasts."""
    config = fleet_config(system.free_multicast_url(), system.free_tcp_port(), robots=FLEET)
    async with serving(folder, config) as running:
        yield running


@pytest_asyncio.fixture
async def server(tmp_path: Path) -> AsyncGenerator[Running]:
    """A server with one robot."""
    async with rover_server(tmp_path) as running:
        yield running


@pytest_asyncio.fixture
async def console(server: Running, tmp_path: Path) -> AsyncGenerator[Console]:
    """A console in front of it; its fleet is called `hall`."""
    async with console_at(tmp_path, {"hall": server.url}) as running:
        yield running


@pytest.fixture
def plant(tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Plant:
    """A fleet of three machines, each behind a bridge of its own; people decide."""
    return Plant(tmp_path, udp_url, tcp_port, processes, "operator")
