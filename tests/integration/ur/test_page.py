"""The fleet of docs/ur.md, as it stands there, with server and bridge as processes, signed and encrypted."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.system import Child, Processes, clean_environment
from tests.unit.docs.pages import ROOT, blocks
from tests.ur_controller import UrController
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.errors import RobotOffline

pytestmark = pytest.mark.needs("ur")

PAGE = ROOT / "docs" / "ur.md"
USER, PASSWORD = "oscar", "operate-1"


async def until_read(client: FleetClient, node: str, check: Callable[[object], bool]) -> None:
    value: object = None
    try:
        async with asyncio.timeout(60):
            while not check(value):
                value = (await client.read([node]))[0].value
                await asyncio.sleep(0.02)
    except TimeoutError:
        raise AssertionError(f"{node} is {value!r}") from None


def children_of(pid: int) -> list[int]:
    """Processes with ur-rtde that a bridge has started."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


async def test_the_pages_fleet_runs_secured(
    tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes, controller: UrController
) -> None:
    text = next(found.text for found in blocks("yaml") if found.page == PAGE)
    (tmp_path / "fleet.yaml").write_text(text.replace("192.168.0.10", controller.host))
    environment = clean_environment(
        PYTHONUNBUFFERED="1",
        UA_FLEET_CONFIG=str(tmp_path / "fleet.yaml"),
        UA_FLEET__SERVER__PORT=str(tcp_port),
        UA_FLEET__SERVER__TRUST_ALL_CLIENTS="true",
        UA_FLEET__PUBSUB__URL=udp_url,
        UA_FLEET__PUBSUB__KEYS__SOURCE="files",
    )

    def cli(*arguments: str) -> Child:
        return processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=environment)

    users = UserStore(tmp_path / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(mode=0o700)
    users.add(USER, PASSWORD, Role.OPERATOR)
    assert cli("keys", "create").process.wait(60) == 0
    cli("serve").wait_for("ready")
    bridge = cli("bridge", "robot_cell")
    bridge.wait_for("ready")
    url, identity = f"opc.tcp://127.0.0.1:{tcp_port}/ua_fleet", ClientIdentity(tmp_path / "identity")
    async with FleetClient.connect(url, user=USER, password=PASSWORD, identity=identity) as client:
        await until_read(client, "ns=2;s=1912.safety_mode", lambda value: value == "NORMAL")
        async with asyncio.timeout(60):
            while True:
                try:
                    await client.call_skill("ur5", "grip", close=True)
                except RobotOffline:
                    await asyncio.sleep(0.05)
                else:
                    break
        assert controller.state()["digital_outputs"] == 1 << 16
        assert await client.call_skill("ur5", "turn", base=0.5) == {}
        await until_read(client, "ns=2;i=1910", lambda q: str(q).strip("[(").startswith("0.5"))
        assert await client.call_skill("ur5", "weigh", label="part 7", seconds=0.1) == {"mass": 0.0}
        assert "part 7" in controller.log()
        controller.do("protective_stop")
        await until_read(client, "ns=2;s=1912.safety_mode", lambda value: value == "PROTECTIVE_STOP")
        await until_read(client, "ns=2;i=1902", lambda value: str(value).startswith("protective stop"))
        await asyncio.sleep(0.3)
        assert await client.call_skill("ur5", "unlock") == {}
        assert await client.call_skill("ur5", "lower", z=0.45) == {}
        assert await client.call_skill("ur5", "load", program="pick.urp") == {}
        assert await client.call_skill("ur5", "play") == {}
        # A bridge that is killed takes ur-rtde with it, and the arm goes on; the next one sees where it ends.
        await client.call_skill("ur5", "turn", base=0.0)
        children = children_of(bridge.process.pid)
        assert len(children) >= 2  # one reads, one commands, one asks unless it is put off
        execution = await client.start_skill("ur5", "turn", base=2.0)
        async with asyncio.timeout(60):
            while controller.state()["q"][0] < 0.1:
                await asyncio.sleep(0.01)
        os.kill(bridge.process.pid, signal.SIGKILL)  # it alone, and not its group
        async with asyncio.timeout(60):
            while any(Path(f"/proc/{child}").exists() for child in children):
                await asyncio.sleep(0.01)
        cli("bridge", "robot_cell").wait_for("ready")
        assert await execution.result(timeout_s=20) == {}
        assert controller.state()["q"][0] == pytest.approx(2.0, abs=0.005)
