"""A secured fleet as processes: server with its key service, a TCP bridge with its robot, and the Modbus gateway."""

from __future__ import annotations

import asyncio
import json
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pytest

from tests.scraped import Samples, scrape
from tests.system import Child, Processes, clean_environment, free_multicast_url, free_tcp_port
from ua_fleet.cli.health import HealthQuestion, HealthVerdict, check
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.monitoring.address import ADDRESS_FILE

USER, PASSWORD = "oscar", "0pen-sesame-4711"

FLEET = """\
version: 1
server: {{port: {port}, trust_all_clients: true}}
pubsub:
  security: sign_and_encrypt
  url: {url}
  keep_alive_s: 0.2
  receive_timeout_s: 0.8
bridges:
  cell:
    kind: tcp
    space: 300
    status_id: 1
    interpreter: {{connect: "127.0.0.1:{robot}", framing: acknowledged}}
history: {{}}
robots:
  machine:
    bridge: cell
    capacities: [weld]
    skill_status_id: 1902
    data: {{position: {{id: 10, fields: {{x: {{type: Double, unit: m}}, y: {{type: Double, unit: m}}}}}}}}
    skills:
      work:
        id: 1900
        timeout_s: 20
        needs: [weld]
        arguments: {{work: {{type: String}}, seconds: {{type: Double}}}}
        results: {{}}
resilience: {{mode: operator, limit_s: 600, silence_s: 4}}
modbus:
  port: {modbus}
  robots: [machine]
  values: {{machine.position.x: {{table: input, address: 100, type: float32}}}}
"""
SHIFT = """\
version: 1
name: shift
steps:
  - task: first
    robot: machine
    skill: work
    arguments: {work: weld, seconds: 0.2}
  - task: second
    robot: machine
    skill: work
    arguments: {work: paint, seconds: 0.2}
"""


STATE: Final = {"server": "state", "bridge": "state/bridges/cell", "modbus": "state/modbus"}
"""Folders of the processes, by what they are."""
COMMANDS: Final = {"server": ("serve",), "bridge": ("bridge", "cell"), "modbus": ("modbus", "serve", "-u", USER)}


@dataclass
class Plant:
    """The fleet's folder and its processes."""

    folder: Path
    endpoint: str
    url: str
    robot_port: int
    processes: Processes
    children: dict[str, Child] = field(default_factory=dict[str, Child])
    ended: list[Child] = field(default_factory=list[Child])

    def cli(self, *arguments: str) -> Child:
        """Start a command of the fleet, with all that its log can say."""
        environment = clean_environment(
            PYTHONUNBUFFERED="1",
            UA_FLEET_CONFIG=str(self.folder / "fleet.yaml"),
            UA_FLEET_ENDPOINT=self.endpoint,
            UA_FLEET_USER=USER,
            UA_FLEET_PASSWORD=PASSWORD,
            UA_FLEET_LOG="debug",
            XDG_STATE_HOME=str(self.folder / "state-of-client"),
        )
        return self.processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=environment)

    async def start(self, process: str) -> None:
        """Start a process, and wait until it says that it works."""
        if (before := self.children.get(process)) is not None:
            self.ended.append(before)
        self.children[process] = child = self.cli(*COMMANDS[process])
        await asyncio.to_thread(child.wait_for, "ready", 60)

    async def start_robot(self) -> None:
        """Start the robot."""
        place = f"127.0.0.1:{self.robot_port}"
        options = ("--listen", place, "--framing", "acknowledged", "--memory", str(self.folder / "memory"))
        child = self.processes.start(
            sys.executable, "-m", "ua_demo.simulators.tcp", *options, env=clean_environment(PYTHONUNBUFFERED="1")
        )
        self.children["robot"] = child
        await asyncio.to_thread(child.wait_for, "ready", 30)

    async def end(self, process: str, number: int) -> None:
        """End a process."""
        await asyncio.to_thread(self.children[process].end, number)

    def log(self, process: str) -> list[dict[str, Any]]:
        """What a process has logged since its start, each line as the JSON that it is."""
        return [json.loads(line) for line in self.children[process].lines if line.startswith("{")]

    def said(self, process: str, event: str, **ids: object) -> list[dict[str, Any]]:
        """Those lines with an event and ids."""
        return [
            line
            for line in self.log(process)
            if line["event"] == event and all(line.get(name) == value for name, value in ids.items())
        ]

    def monitoring_url(self, process: str) -> str:
        """Where a process tells how it is."""
        written = json.loads((self.folder / STATE[process] / ADDRESS_FILE).read_text())
        return f"http://{written['host']}:{written['port']}"

    async def samples(self, process: str) -> Samples:
        """The metrics of a process."""
        return await asyncio.to_thread(scrape, self.monitoring_url(process))

    async def health(self, process: str, *, live: bool = False, timeout_s: float = 3.0) -> HealthVerdict:
        """What `ua-fleet healthcheck` says of a process."""
        folder = str(self.folder / STATE[process])
        return await asyncio.to_thread(check, HealthQuestion(state_dir=folder, live=live, timeout_s=timeout_s))

    def client(self) -> Any:
        """An operator's client."""
        identity = ClientIdentity(self.folder / "identity")
        return FleetClient.connect(self.endpoint, user=USER, password=PASSWORD, identity=identity)

    def everything_logged(self) -> str:
        """The output of all processes, those that were ended too."""
        children = [*self.ended, *self.children.values()]
        return "\n".join(line for child in children for line in child.lines)


async def until(condition: Callable[[], Any], what: str, timeout_s: float = 60) -> None:
    """Wait until something holds; it may be a coroutine function."""
    last: Any = None
    try:
        async with asyncio.timeout(timeout_s):
            while True:
                last = condition()
                if asyncio.iscoroutine(last):
                    last = await last
                if last:
                    return
                await asyncio.sleep(0.1)
    except TimeoutError:
        raise AssertionError(f"{what} did not come; the last was {last!r}") from None


@pytest.fixture
async def plant(tmp_path: Path, processes: Processes) -> Plant:
    """All processes, ready."""
    port, robot, modbus, url = free_tcp_port(), free_tcp_port(), free_tcp_port(), free_multicast_url()
    (tmp_path / "fleet.yaml").write_text(FLEET.format(port=port, url=url, robot=robot, modbus=modbus))
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "scenarios" / "shift.yaml").write_text(SHIFT)
    users = UserStore(tmp_path / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(mode=0o700)
    users.add(USER, PASSWORD, Role.OPERATOR)
    made = Plant(tmp_path, f"opc.tcp://127.0.0.1:{port}/ua_fleet", url, robot, processes)
    assert made.cli("cert", "create", "--bridge", "cell", "--trust").process.wait(60) == 0
    await made.start("server")
    await made.start_robot()
    await asyncio.gather(made.start("bridge"), made.start("modbus"))
    return made


def names(exposition: str) -> set[str]:
    """The names of the metrics of ours in the text format, with `_total`."""
    return set(re.findall(r"^# TYPE (ua_fleet_\w+) ", exposition, re.MULTILINE))
