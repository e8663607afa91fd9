"""A fleet with a robot of every kind that there is a bridge for; all programs as users start them, PubSub encrypted.

What robots do is read from themselves: each writes down what it begins, ends and refuses, and shares no code with its
bridge, but for the simulated controller of the UR arm. A job takes its last two digits in tenths of a second; every
robot refuses one below 0.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Awaitable, Callable, Generator, Mapping
from contextlib import AbstractAsyncContextManager, contextmanager
from pathlib import Path
from typing import Any, Final

from asyncua.client.client import Client

from tests import system
from tests.contract.ros1 import Master
from tests.integration.scenarios.conftest import call, says, value
from tests.integration.server_model.harness import OPERATOR, connected
from tests.plugged_device import PtyDevice
from tests.system import Child, Processes, clean_environment, free_multicast_url, free_tcp_port
from tests.ur_controller import UrController
from ua_fleet.config.load import load
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.server.mutual_trust import introduce_bridge

__all__ = ["BRIDGES", "ROBOTS", "EveryKind", "Ledger"]

BRIDGES: Final = {
    "press": "tcp_cell",
    "belt": "plc_cell",
    "ur5": "ur_cell",
    "arm": "ros1_cell",
    "carrier": "ros2_cell",
    "box": "plugged_cell",
}
ROBOTS: Final = tuple(BRIDGES)
Ledger = dict[str, list[str]]
"""What each robot did, e.g. `begun 130`, in its order."""

_PROGRAMS: Final = Path(__file__).parent / "robots"
_SKILL_IDS: Final = {robot: 1100 + number for number, robot in enumerate(ROBOTS)}
_SCRIPT: Final = """\
if {job} < 0:
  textmsg("refused ", {job})
  halt
end
textmsg("begun ", {job})
sleep(0.1 * ({job} - 100 * floor({job} / 100)))
textmsg("done ", {job})
"""
_WAYS: Final[Mapping[str, Any]] = {
    "belt": {
        "request": {"table": "holding", "address": 0},
        "accepted": {"table": "holding", "address": 1},
        "busy": {"table": "holding", "address": 2, "bit": 0},
        "done": {"table": "holding", "address": 2, "bit": 1},
        "error": {"table": "holding", "address": 2, "bit": 2},
        "error_text": {"table": "holding", "address": 10, "type": "string", "length": 20},
        "arguments": {"job": {"table": "holding", "address": 4, "type": "int32"}},
        "poll_s": 0.05,
    },
    "ur5": {"script": {"body": _SCRIPT}},
    "arm": {"action": {"name": "/work", "type": "actionlib/Test", "fields": {"job": "goal"}}},
    "box": {"device": "box", "command": "JOB {job}\n", "done": "DONE", "failed": "ERR {message}"},
}


class _Box:
    """The firmware of a device on a serial port. It forgets a job as soon as it is over."""

    def __init__(self, path: Path) -> None:
        self.device = PtyDevice(path, self._obey)
        self.lines: list[str] = []

    def _obey(self, device: PtyDevice, line: str) -> None:
        word, _, number = line.partition(" ")
        if word != "JOB":
            return
        job = int(number)
        self.lines.append(f"{'refused' if job < 0 else 'begun'} {job}")
        if job < 0:
            device.say("ERR it does not go into the box\n")
            return
        timer = threading.Timer(job % 100 / 10, self._end, (device, job))
        timer.daemon = True
        timer.start()

    def _end(self, device: PtyDevice, job: int) -> None:
        self.lines.append(f"done {job}")
        device.say("DONE\n")


class EveryKind:
    """The fleet and all its processes."""

    def __init__(self, folder: Path, processes: Processes, domain: int, scenarios: Mapping[str, str]) -> None:
        self.folder, self._processes, self._domain = folder, processes, domain
        self._master = Master(folder, processes)
        self._controller = UrController(processes)
        self._box = _Box(folder / "ttyBox")
        self._fault_file = folder / "fault"
        self._ports = {"press": free_tcp_port(), "belt": free_tcp_port()}
        self._robots: dict[str, Child] = {}
        self._bridges: dict[str, Child] = {}
        self._server: Child | None = None
        self._fleet = folder / "fleet.json"
        self._fleet.write_text(json.dumps(self._configuration()))
        self.config = load(self._fleet)
        (folder / "scenarios").mkdir()
        for name, steps in scenarios.items():
            text = f"version: 1\nname: {name}\ndescription: for a test\nsteps:\n{steps}"
            (folder / "scenarios" / f"{name}.yaml").write_text(text)

    def _configuration(self) -> dict[str, Any]:
        quick = {"retry_s": [0.05, 0.5]}
        cells: dict[str, dict[str, Any]] = {
            "press": {"kind": "tcp", "space": 300, "interpreter": {"connect": f"127.0.0.1:{self._ports['press']}"}},
            "belt": {
                "kind": "modbus",
                "space": 301,
                "devices": {"plc": {"host": "127.0.0.1", "port": self._ports["belt"], **quick}},
            },
            "ur5": {"kind": "ur", "space": 302, "address": self._controller.host, **quick},
            "arm": {"kind": "ros1", "space": 1, "master_uri": self._master.uri, "host_ip": "127.0.0.1"},
            "carrier": {"kind": "ros2", "space": self._domain},
            "box": {"kind": "plugged", "space": 303, "devices": {"box": {"path": str(self._box.device.path)}}},
        }
        job = {"arguments": {"job": {"type": "Int32"}}, "timeout_s": 60}
        robots: dict[str, dict[str, Any]] = {}
        for number, robot in enumerate(ROBOTS):
            work = {"id": _SKILL_IDS[robot], "needs": ["weld"], **job}
            if robot in _WAYS:
                work["via"] = _WAYS[robot]
            robots[robot] = {
                "bridge": BRIDGES[robot],
                "capacities": ["weld"],
                "skill_status_id": 1200 + number,
                "skills": {"work": work},
            }
        robots["press"]["capacities"].append("lift")
        robots["press"]["skills"]["lift"] = {"id": 1150, "needs": ["lift"], **job}
        robots["press"]["fault_id"], robots["ur5"]["fault_id"] = 1300, 1302
        return {
            "version": 1,
            "server": {"port": free_tcp_port(), "trust_all_clients": True},
            "pubsub": {"security": "sign_and_encrypt", "url": free_multicast_url()},
            "bridges": {
                BRIDGES[robot]: {**cell, "status_id": 900 + number}
                for number, (robot, cell) in enumerate(cells.items())
            },
            "robots": robots,
            "resilience": {"mode": "automatic"},
        }

    async def prepare(self) -> None:
        """Make a user, and let the server know the bridges."""
        users = UserStore(self.folder / self.config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.path.parent.mkdir(parents=True, exist_ok=True)
        users.add(*OPERATOR, Role.OPERATOR)
        for bridge in BRIDGES.values():
            await introduce_bridge(self.config, self.folder, bridge)

    def begin(self) -> None:
        """Switch all robots on, then start the bridges and the server; returns when all say that they are ready."""
        self._master.appear()
        self._box.device.plug()
        ros2 = clean_environment(ROS_DOMAIN_ID=str(self._domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        programs: dict[str, tuple[str | Path, Path, tuple[str | Path, ...], dict[str, str]]] = {
            "press": (sys.executable, _PROGRAMS / "tcp_press.py", (str(self._ports["press"]), self._fault_file), {}),
            "belt": (sys.executable, _PROGRAMS / "plc_belt.py", (str(self._ports["belt"]),), {}),
            "arm": (system.ROS1_PYTHON, _PROGRAMS / "ros1_arm.py", (), self._master.env),
            "carrier": (
                sys.executable,
                _PROGRAMS / "ros2_carrier.py",
                (str(self._domain), str(_SKILL_IDS["carrier"])),
                ros2,
            ),
        }
        for robot, (python, program, arguments, environment) in programs.items():
            self._robots[robot] = self._processes.start(python, "-u", program, *arguments, env=environment or None)
        self._controller.start()
        for child in self._robots.values():
            child.wait_for("ready", timeout_s=60)
        self._start_server()
        for robot in ROBOTS:
            self._start_bridge(robot)
        for child in (self._running_server(), *self._bridges.values()):
            child.wait_for("ready: ", timeout_s=60)

    def end(self) -> None:
        """What is no process of its own ends here."""
        self._box.device.unplug()

    def _start(self, environment: Path, *arguments: str) -> Child:
        more = {"PYTHONUNBUFFERED": "1", "UA_FLEET_RUNTIME_DIR": str(self.folder), "HOME": str(self.folder)}
        environ = clean_environment(**more)
        return self._processes.start(environment / "ua-fleet", *arguments, "--config", self._fleet, env=environ)

    def _running_server(self) -> Child:
        assert self._server is not None
        return self._server

    def _start_server(self) -> None:
        self._server = self._start(Path(sys.executable).parent, "serve")

    def _start_bridge(self, robot: str) -> None:
        environment = system.ROS1_PYTHON if robot == "arm" else Path(sys.executable)
        self._bridges[robot] = self._start(environment.parent, "bridge", BRIDGES[robot])

    def kill_bridges(self, *robots: str) -> None:
        """SIGKILL, all at once."""
        for robot in robots:
            assert self._bridges[robot].end(signal.SIGKILL) == -signal.SIGKILL, "it had ended by itself"

    async def restart_bridges(self, *robots: str, begun: Callable[[], Awaitable[None]] | None = None) -> None:
        """Start them again, and wait until they work; `begun` is called when the first one's program runs."""
        for robot in robots:
            self._start_bridge(robot)
        if begun is not None:
            await says(self._bridges[robots[0]], '"event": ')
            await begun()
        for robot in robots:
            await says(self._bridges[robot], "ready: ")

    async def mend(self) -> None:
        """Start what a test that failed has left dead, end its runs, and clear the faults that it has left."""
        if self._running_server().process.poll() is not None:
            await self.restart_server()
        await self.restart_bridges(*(robot for robot in ROBOTS if self._bridges[robot].process.poll() is not None))
        async with self.client() as client:
            for node in await client.get_node("ns=2;s=Fleet.Scenarios.Runs").get_children():
                run_id = (await node.read_browse_name()).Name
                if await value(client, f"Scenarios.Runs.{run_id}.State") not in ("done", "failed", "aborted"):
                    await call(client, "Scenarios", "Abort", run_id, "its test is over")
            for robot in ROBOTS:
                await call(client, "Faults", "ClearFault", robot)

    def kill_server(self) -> None:
        """SIGKILL."""
        assert self._running_server().end(signal.SIGKILL) == -signal.SIGKILL, "it had ended by itself"

    async def restart_server(self) -> None:
        """Start it again, and wait until it serves."""
        self._start_server()
        await says(self._running_server(), "ready: ")

    def client(self) -> AbstractAsyncContextManager[Client]:
        """An operator's session."""
        return connected(f"opc.tcp://127.0.0.1:{self.config.server.port}/ua_fleet", self.folder, OPERATOR)

    def ledger(self) -> Ledger:
        """What each robot itself has written down so far."""
        words = ("begun ", "done ", "refused ")
        lines = {robot: list(child.lines) for robot, child in self._robots.items()}
        lines |= {"ur5": self._controller.log(), "box": list(self._box.lines)}
        return {robot: [line for line in lines[robot] if line.startswith(words)] for robot in ROBOTS}

    @contextmanager
    def fault_of_press(self, fault: str) -> Generator[None]:
        """The press announces a fault while the context lasts."""
        self._fault_file.write_text(fault)
        try:
            yield
        finally:
            self._fault_file.unlink()

    @contextmanager
    def open_gate(self) -> Generator[None]:
        """The gate of the UR's cell is open while the context lasts: a safeguard stop."""
        self._controller.do("safeguard_stop")
        try:
            yield
        finally:
            self._controller.do("reset_safety")
