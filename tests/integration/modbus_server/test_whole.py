"""A PLC (mbpoll) has another PLC (the simulated one) work, by the fleet: all as processes, all messages encrypted.

Bridge and Modbus device are killed while the PLC works; what was asked for once is done once.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncGenerator
from pathlib import Path

import pytest
import yaml

from tests.contract.modbus import PlcProcess
from tests.integration.modbus_server.conftest import Panel, modbus
from tests.system import Child, Processes, clean_environment, free_tcp_port
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.modbus.words import CommandState

pytestmark = pytest.mark.needs("mbpoll")

USER, PASSWORD = "plc1", "operate-1"
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
  hall:
    kind: modbus
    space: 300
    status_id: 1
    poll_s: 0.05
    devices: {{plc: {{host: 127.0.0.1, port: {plc}, timeout_s: 0.5, retry_s: [0.1, 0.5]}}}}
robots:
  left:
    bridge: hall
    skill_status_id: 1902
    data:
      go_on: {{id: 10, type: Int32, origin: server, initial: 1, sink: {{at: {{table: holding, address: 500}}}}}}
      counter: {{id: 11, type: UInt16, source: {{at: {{table: holding, address: 600}}}}}}
    skills:
      work:
        id: 1900
        timeout_s: 20
        arguments: {{work: {{type: String}}, seconds: {{type: Double}}}}
        results: {{done: {{type: String}}, seconds: {{type: Double}}}}
        via:
          request: {{table: holding, address: 100}}
          accepted: {{table: holding, address: 101}}
          busy: {{table: holding, address: 102, bit: 0}}
          done: {{table: holding, address: 102, bit: 1}}
          error: {{table: holding, address: 102, bit: 2}}
          error_text: {{table: holding, address: 110, type: string, length: 20}}
          arguments:
            work: {{table: holding, address: 130, type: string, length: 20}}
            seconds: {{table: holding, address: 150}}
          results:
            done: {{table: holding, address: 160, type: string, length: 20}}
            seconds: {{table: holding, address: 180}}
          poll_s: 0.05
modbus: {modbus}
"""


class Hall:
    """The fleet's folder, its PLCs and its processes."""

    def __init__(self, folder: Path, processes: Processes, plc: PlcProcess, panel: Panel) -> None:
        self.folder, self._processes, self.plc, self.panel = folder, processes, plc, panel

    def cli(self, *arguments: str) -> Child:
        """Start a command of the fleet."""
        environment = clean_environment(
            PYTHONUNBUFFERED="1",
            UA_FLEET_CONFIG=str(self.folder / "fleet.yaml"),
            UA_FLEET_PASSWORD=PASSWORD,
            XDG_STATE_HOME=str(self.folder / "config"),
            HOME=str(self.folder),
        )
        return self._processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=environment)

    async def ready(self, *arguments: str) -> Child:
        """Start one, and wait until it works."""
        child = self.cli(*arguments)
        await asyncio.to_thread(child.wait_for, "ready", 60)
        return child


@pytest.fixture
async def hall(tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> AsyncGenerator[Hall]:
    ports = {"plc": free_tcp_port(), "device": free_tcp_port()}
    section = modbus(port=ports["device"], robots=["left"])
    section["values"]["left.counter"] = {"table": "input", "address": 120}
    del section["commands"]["shift"]
    text = FLEET.format(
        port=tcp_port,
        url=udp_url,
        plc=ports["plc"],
        modbus=yaml.safe_dump(section, default_flow_style=True, width=9999, sort_keys=False),
    )
    (tmp_path / "fleet.yaml").write_text(text)
    users = UserStore(tmp_path / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(mode=0o700)
    users.add(USER, PASSWORD, Role.OPERATOR)
    plc = PlcProcess("--port", str(ports["plc"]))
    try:
        made = Hall(tmp_path, processes, plc, Panel(ports["device"]))
        assert made.cli("keys", "create").process.wait(60) == 0
        await made.ready("serve")
        yield made
    finally:
        plc.end()


async def test_plc_has_another_plc_work_and_kills_change_nothing(hall: Hall) -> None:
    endpoint = (
        "-e",
        f"opc.tcp://127.0.0.1:{yaml.safe_load((hall.folder / 'fleet.yaml').read_text())['server']['port']}/ua_fleet",
    )
    bridge = await hall.ready("bridge", "hall")
    device = await hall.ready("modbus", "serve", "-u", USER, *endpoint)
    panel, plc = hall.panel, hall.plc
    async with asyncio.timeout(60):
        await panel.until(lambda words: words[0] == 1, "connected", timeout_s=60)
        while await panel.ended(await panel.ask_for_work("warm up", 0)) is not CommandState.DONE:
            await asyncio.sleep(0.2)
        # Data: the PLC's register in the panel's, and what the panel sets in the PLC's.
        plc.do("put", table="holding", address=600, type="uint16", values=[4711])
        while await panel.read("input", 120) != [4711]:
            await asyncio.sleep(0.05)
        assert await panel.write(60, 0, 42)
        while plc.do("cells", table="holding", address=500, count=2)["cells"] != [0, 42]:
            await asyncio.sleep(0.05)
    plc.told.clear()
    # The bridge is killed while the PLC works.
    number = await panel.ask_for_work("weld", 20)
    while plc.told != ["weld"]:
        await asyncio.sleep(0.02)
    await asyncio.to_thread(bridge.end, signal.SIGKILL)
    bridge = await hall.ready("bridge", "hall")
    assert await panel.ended(number, 30) is CommandState.DONE
    # The Modbus device is killed while the PLC works.
    number = await panel.ask_for_work("paint", 20)
    while plc.told != ["weld", "paint"]:
        await asyncio.sleep(0.02)
    await panel.until(lambda words: words == [number, CommandState.RUNNING], "answer", 2)
    await asyncio.to_thread(device.end, signal.SIGKILL)
    device = await hall.ready("modbus", "serve", "-u", USER, *endpoint)
    assert await panel.write(0, number)
    assert await panel.ended(number, 30) is CommandState.DONE
    words = await panel.read("input", 110, 8)
    assert b"".join(word.to_bytes(2, "big") for word in words).rstrip(b"\0") == b"paint"
    assert plc.told == ["weld", "paint"]
    # The link between bridge and PLC drops while it works: the values are not shown as fresh, and the end arrives.
    number = await panel.ask_for_work("polish", 20)
    while plc.told != ["weld", "paint", "polish"]:
        await asyncio.sleep(0.02)
    plc.do("hang up")
    await panel.until(lambda words: words[0] == number, "answer")
    async with asyncio.timeout(60):
        while (await panel.read("discrete", 0, 2))[1] != 0:
            await asyncio.sleep(0.05)
    await asyncio.to_thread(bridge.wait_for, "not connected to the space")
    plc.do("listen")
    assert await panel.ended(number, 30) is CommandState.DONE
    assert plc.told == ["weld", "paint", "polish"]
    await asyncio.sleep(1.5)  # it tells its state each second
    assert sum("not connected to the space" in line for line in bridge.lines) == 1
    assert sum("connected to the space" in line for line in bridge.lines) == 3
    assert await asyncio.to_thread(device.end, signal.SIGTERM) == 130
