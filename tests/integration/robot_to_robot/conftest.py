"""A fleet whose server and bridges are processes as users start them, signed and encrypted."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from tests.system import Child, Processes, clean_environment, free_tcp_port
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.errors import RobotOffline

USER: Final = "oscar"
PASSWORD: Final = "operate-1"


class Hall:
    """The folder of a fleet, and what runs in it."""

    def __init__(self, folder: Path, udp_url: str, processes: Processes) -> None:
        self.folder, self.processes = folder, processes
        self._udp_url, self._port = udp_url, free_tcp_port()
        self._environment = clean_environment(
            PYTHONUNBUFFERED="1", UA_FLEET_CONFIG=str(folder / "fleet.yaml"), XDG_STATE_HOME=str(folder / "users")
        )

    @property
    def endpoint(self) -> str:
        """URL of the server."""
        return f"opc.tcp://127.0.0.1:{self._port}/ua_fleet"

    def write(self, bridges: dict[str, Any], robots: dict[str, Any], **more: Any) -> None:
        """Write the configuration, and make the keys."""
        fleet = {
            "version": 1,
            "server": {"port": self._port, "trust_all_clients": True},
            "pubsub": {"security": "sign_and_encrypt", "url": self._udp_url, "keys": {"source": "files"}},
            "bridges": bridges,
            "robots": robots,
            **more,
        }
        (self.folder / "fleet.yaml").write_text(json.dumps(fleet, indent=2))
        keys = self.cli("keys", "create")
        assert keys.process.wait(60) == 0, "\n".join(keys.lines)

    def cli(self, *arguments: str | Path) -> Child:
        """Start a command."""
        return self.processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=self._environment)

    def start(self, *bridges: str, server: bool) -> None:
        """Start bridges, and the server with its user, and wait until they work."""
        children = [self.cli("bridge", bridge) for bridge in bridges]
        if server:
            users = UserStore(self.folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
            users.path.parent.mkdir(mode=0o700, exist_ok=True)
            users.add(USER, PASSWORD, Role.OPERATOR)
            children.append(self.cli("serve"))
        for child in children:
            child.wait_for("ready")

    @asynccontextmanager
    async def client(self) -> AsyncGenerator[FleetClient]:
        """The user's client."""
        identity = ClientIdentity(self.folder / "identity")
        async with FleetClient.connect(self.endpoint, user=USER, password=PASSWORD, identity=identity) as client:
            yield client


async def done(client: FleetClient, robot: str, skill: str, **arguments: Any) -> dict[str, Any]:
    """Have a skill done, as soon as the server hears the robot; its results."""
    async with asyncio.timeout(60):
        while True:
            try:
                return await client.call_skill(robot, skill, **arguments)
            except RobotOffline:
                await asyncio.sleep(0.05)


@pytest.fixture
def hall(tmp_path: Path, udp_url: str, processes: Processes) -> Hall:
    """An empty hall."""
    return Hall(tmp_path, udp_url, processes)
