"""A TCP robot in a whole fleet: server and bridge as processes, secured, and a bridge that is killed at work."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
from collections.abc import AsyncGenerator
from pathlib import Path

import pytest

from tests.integration.tcp.conftest import StartRobot
from tests.system import Child, Processes, clean_environment, free_tcp_port
from tests.waiting import until
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.errors import RobotOffline

USER, PASSWORD = "oscar", "operate-1"

FLEET = """\
version: 1
server: {{port: {port}, trust_all_clients: true}}
pubsub:
  security: sign_and_encrypt
  url: {url}
  keep_alive_s: 0.2
  receive_timeout_s: 0.8
  keys: {{source: files}}
bridges:
  cell: {{kind: tcp, space: 300, status_id: 1, interpreter: {{connect: "127.0.0.1:{robot}", framing: acknowledged}}}}
robots:
  machine:
    bridge: cell
    capacities: [weld]
    skill_status_id: 1902
    data: {{position: {{id: 10, fields: {{x: {{type: Double, unit: m}}, y: {{type: Double, unit: m}}}}}}}}
    skills:
      move:
        id: 1900
        timeout_s: 20
        arguments: {{x: {{type: Double}}, y: {{type: Double}}, seconds: {{type: Double}}}}
        results: {{}}
"""


class Cell:
    """The fleet's folder, its robot and its client."""

    def __init__(self, folder: Path, processes: Processes, client: FleetClient) -> None:
        self.folder, self._processes, self.client = folder, processes, client
        self.memory = folder / "memory"

    def bridge(self) -> Child:
        """Start the bridge."""
        child = start_cli(self._processes, self.folder, "bridge", "cell")
        child.wait_for("ready")
        return child

    def told(self) -> int:
        """How often the robot was told to move."""
        return len(self.memory.read_text().splitlines()) if self.memory.exists() else 0

    async def reachable(self) -> None:
        """Wait until the server can command the robot."""
        async with asyncio.timeout(60):
            while True:
                try:
                    await self.client.call_skill("machine", "move", x=0.0, y=0.0, seconds=0.0)
                except RobotOffline:
                    await asyncio.sleep(0.05)
                else:
                    return


def start_cli(processes: Processes, folder: Path, *arguments: str) -> Child:
    environment = clean_environment(PYTHONUNBUFFERED="1", UA_FLEET_CONFIG=str(folder / "fleet.yaml"))
    return processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=environment)


@pytest.fixture
async def cell(
    tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes, start_robot: StartRobot
) -> AsyncGenerator[Cell]:
    robot_port = free_tcp_port()
    (tmp_path / "fleet.yaml").write_text(FLEET.format(port=tcp_port, url=udp_url, robot=robot_port))
    users = UserStore(tmp_path / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(mode=0o700)
    users.add(USER, PASSWORD, Role.OPERATOR)
    assert start_cli(processes, tmp_path, "keys", "create").process.wait(60) == 0
    start_cli(processes, tmp_path, "serve").wait_for("ready")
    start_robot("--listen", f"127.0.0.1:{robot_port}", "--framing", "acknowledged", "--memory", tmp_path / "memory")
    url, identity = f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet", ClientIdentity(tmp_path / "identity")
    async with FleetClient.connect(url, user=USER, password=PASSWORD, identity=identity) as client:
        yield Cell(tmp_path, processes, client)


async def test_commands_and_data_secured(cell: Cell) -> None:
    cell.bridge()
    await cell.reachable()
    assert await cell.client.call_skill("machine", "move", x=1.5, y=-2.0, seconds=0.1) == {}
    async with asyncio.timeout(60):
        while [reading.value for reading in await cell.client.read(["ns=2;s=10.x", "ns=2;s=10.y"])] != [1.5, -2.0]:
            await asyncio.sleep(0.05)


async def test_a_bridge_that_was_killed_at_work_finds_out_what_became_of_it(cell: Cell) -> None:
    bridge = cell.bridge()
    await cell.reachable()
    execution = await cell.client.start_skill("machine", "move", x=1.0, y=1.0, seconds=2.0)
    await until(lambda: cell.told() == 2)
    bridge.end(signal.SIGKILL)
    cell.bridge()
    assert await execution.result(timeout_s=15) == {}
    assert cell.told() == 2
    numbers = [json.loads(line)[0] for line in cell.memory.read_text().splitlines()]
    assert len(set(numbers)) == 2
