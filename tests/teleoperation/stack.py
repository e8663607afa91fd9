"""The whole chain as processes: tabs, a console, a server, bridges, robots, and the links between them.

    tab - link - console - link - server - link - bridge - robot        one of each for a lane, but
                                                                        one console and one server for all

Each lane has a fleet of its own at the console, all of which are the same server, each by a link of its own. So one
lane's link is cut while the others drive.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Collection, Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path
from typing import Any, Final

from ua_bridges.ros2.environment import PROFILES_VARIABLE, profile_path

from tests import system
from tests.contract.ros1 import Master
from tests.integration.server_model.harness import ENGINEER, OPERATOR
from tests.system import ROOT, Child, Processes
from tests.teleoperation.judge import Entry, Grant, Rules, Waited, Wish
from tests.teleoperation.plan import LANES
from ua_fleet.config.load import load
from ua_fleet.config.security import all_groups
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy

PROGRAMS: Final = Path(__file__).parent / "programs"
INTEGRATION: Final = ROOT / "tests" / "integration"
NODES: Final = INTEGRATION / "teleoperation" / "nodes"
SPEED, ACCELERATION, DECELERATION, JERK = 0.5, 2.0, 2.0, 40.0
RULES: Final = Rules(
    deadman_s=1.0,  # more than usual: several processes share two cores with other tests
    period_s=0.02,
    robot_timeout_s=0.5,
    stop_s=ACCELERATION / JERK + SPEED / DECELERATION + DECELERATION / JERK,
    rise_s=ACCELERATION / JERK,
    slack_s=0.15,
)
SECURED: Final[dict[str, Any]] = {"security": "sign_and_encrypt", "keys": {"source": "files"}}


def _descendants(pid: int) -> Iterator[int]:
    """The processes that a process has started, and those that these have."""
    children: list[int] = []
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # it has ended meanwhile
        for thread in os.listdir(f"/proc/{pid}/task"):
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                children += map(int, Path(f"/proc/{pid}/task/{thread}/children").read_text().split())
    for child in children:
        yield child
        yield from _descendants(child)


def _waited(line: str) -> Waited | None:
    """What a program printed of its waiting; see `nodes/waited.py`."""
    if not line.startswith("waited "):
        return None
    _, at, *threads = line.split()
    return Waited(float(at), {name: float(total) for name, _, total in (each.partition("=") for each in threads)})


class Controlled:
    """A program that is told what to do; see `programs/control.py`."""

    def __init__(self, child: Child, path: Path) -> None:
        self.child, self._path = child, path
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._turn = asyncio.Lock()

    async def ask(self, **said: Any) -> dict[str, Any]:
        """Tell it something; what it answers. One request after the other."""
        loop = asyncio.get_running_loop()
        if self._loop is not loop:
            self._streams, self._loop, self._turn = None, loop, asyncio.Lock()
        async with self._turn:
            if self._streams is None:
                self._streams = await asyncio.open_unix_connection(str(self._path))
            reader, writer = self._streams
            writer.write(json.dumps(said).encode() + b"\n")
            line = await reader.readline()
        assert line, "\n".join(self.child.lines[-20:])
        answer: dict[str, Any] = json.loads(line)
        assert "error" not in answer, f"{said}: {answer['error']}"
        return answer

    def freeze(self) -> None:
        """Have it stand still, with all processes that it has started."""
        for pid in [self.child.process.pid, *_descendants(self.child.process.pid)]:
            os.kill(pid, signal.SIGSTOP)

    def go_on(self) -> None:
        """Have all of them go on."""
        for pid in [self.child.process.pid, *_descendants(self.child.process.pid)]:
            os.kill(pid, signal.SIGCONT)

    async def close(self) -> None:
        """Close the connection, before its event loop ends."""
        if self._streams is not None:
            writer = self._streams[1]
            self._streams = None
            writer.close()
            with contextlib.suppress(OSError):
                await writer.wait_closed()


class Lane:
    """One robot, its bridge, its operator, and an engineer who may take it over."""

    def __init__(self, stack: Stack, number: int, space: int, master: Master | None) -> None:
        self.stack, self.number, self.space, self._master = stack, number, space, master
        self.robot_name, self.bridge_name = f"carrier{number}", f"floor{number}"
        self.teleoperation = f"ns=2;i={self.id(3)}"
        self.ports = {name: system.free_tcp_port() for name in ("tab", "server")}
        self.far = system.free_multicast_url()
        self.robot: Child
        self.bridge: Child
        self.tab: Controlled
        self.engineer: Controlled
        self._page: Controlled | None = None

    def id(self, place: int) -> int:
        """An id of this lane."""
        return 1000 + 100 * self.number + place

    @property
    def links(self) -> dict[str, Any]:
        """For `programs/links.py`."""
        stack = self.stack
        return {
            f"tab link {self.number}": {"listen": self.ports["tab"], "to": stack.console_port},
            f"server link {self.number}": {"listen": self.ports["server"], "to": stack.server_port},
            f"bridge link {self.number}": {"near": stack.near, "far": self.far},
        }

    @property
    def robot_config(self) -> dict[str, Any]:
        """In fleet.yaml."""
        axis = {"speed": SPEED, "acceleration": ACCELERATION, "deceleration": DECELERATION, "jerk": JERK}
        fields = {"linear": {"type": "Double", "path": "linear.x"}, "angular": {"type": "Double", "path": "angular.z"}}
        return {
            "bridge": self.bridge_name,
            "data": {
                "cmd_vel": {
                    "id": self.id(2),
                    "origin": "server",
                    "fields": fields,
                    "sink": {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"},
                }
            },
            "teleoperation": {
                "id": self.id(3),
                "acquire_id": self.id(4),
                "renew_id": self.id(5),
                "release_id": self.id(6),
                "data": "cmd_vel",
                "axes": {"linear": axis, "angular": axis},
                "deadman_ms": round(RULES.deadman_s * 1000),
                "robot_timeout_ms": round(RULES.robot_timeout_s * 1000),
                "period_ms": round(RULES.period_s * 1000),
            },
        }

    @property
    def bridge_config(self) -> dict[str, Any]:
        """In fleet.yaml."""
        own: dict[str, Any] = {"kind": "ros2", "space": self.space, "status_id": self.id(1)}
        return own if self._master is None else {**own, "kind": "ros1", "master_uri": self._master.uri}

    def start_robot(self) -> None:
        """Start the robot's program, with its own watch."""
        timeout = str(RULES.robot_timeout_s)
        if self._master is not None:
            env = self._master.env | {"PYTHONPATH": "bridges"}
            command: list[str | Path] = [system.ROS1_PYTHON, "-u", NODES / "carrier_ros1.py", timeout, "waited"]
        else:
            env = system.clean_environment(
                ROS_DOMAIN_ID=str(self.space), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", PYTHONPATH="bridges"
            )
            env[PROFILES_VARIABLE] = str(profile_path("robot"))
            command = [sys.executable, "-u", NODES / "carrier_ros2.py", str(self.space), timeout, "waited"]
        self.robot = self.stack.processes.start(*command, env=env)

    def start_bridge(self) -> None:
        """Start the bridge, at the far end of its link."""
        if self._master is not None:
            env, python = self._master.env, str(system.ROS1_PYTHON)
        else:
            env = system.clean_environment(PYTHONPATH=os.pathsep.join(("bridges", ".")))
            env.pop(PROFILES_VARIABLE, None)
            python = sys.executable
        folder = self.stack.folder
        file = self.stack.write_fleet(f"{self.bridge_name}.json", self.far)
        env = env | {"UA_FLEET_RUNTIME_DIR": str(folder), "PYTHONUNBUFFERED": "1"}
        self.bridge = self.stack.processes.start(python, PROGRAMS / "bridge.py", file, self.bridge_name, env=env)

    def start_tab(self) -> None:
        """Start the operator's device."""
        self.tab = self.stack.device(self, OPERATOR, self.ports["tab"], self.ports["server"])
        self.tab.child.wait_for("ready", 60)

    def start_engineer(self) -> None:
        """Start the engineer's, whose links are never disturbed."""
        self.engineer = self.stack.device(self, ENGINEER, self.stack.console_port, self.stack.server_port)

    def start_page(self) -> None:
        """Begin to start the operator's device as a tab of a real browser, which takes its while."""
        ports = self.ports
        self._page = self.stack.device(self, OPERATOR, ports["tab"], ports["server"], program="page.py")

    @property
    def page(self) -> Controlled:
        """That tab; `start_page` was called."""
        assert self._page is not None
        self._page.child.wait_for("ready", 60)
        return self._page

    @property
    def devices(self) -> list[Controlled]:
        """All of them."""
        return [device for device in (self.tab, self.engineer, self._page) if device is not None]

    def moved(self, since: float) -> list[Entry]:
        """What the robot recorded: how it moves, after its own watch."""
        return self._recorded("moved ", since)

    def heard(self, since: float) -> list[Entry]:
        """What the robot recorded: what its bridge wrote to it."""
        return self._recorded("heard ", since)

    def _recorded(self, what: str, since: float) -> list[Entry]:
        found = [line.split() for line in list(self.robot.lines) if line.startswith(what)]
        return [entry for entry in (Entry(float(each[1]), float(each[2])) for each in found) if entry.at >= since]

    def wishes(self, since: float) -> list[Wish]:
        """What all devices of this lane have sent."""
        found, published = self.stack.printed(self, "wish", 6), self._published()
        wishes = [
            # A device has seen no counter before it was published. What the bridge has printed may not be read yet, and
            # counters begin anew with a bridge that was restarted: one of the same number was published later then.
            Wish(float(sent), min(float(seen), published.get(echo, inf)), int(lease), float(speed))
            for _, sent, seen, lease, speed, echo in found
        ]
        return sorted(wish for wish in wishes if wish.sent >= since)

    def _published(self) -> dict[str, float]:
        """When its bridge published each counter."""
        found = [line.split() for line in list(self.bridge.lines) if line.startswith("counter ")]
        return {each[1]: float(each[2]) for each in found if len(each) == 3}

    def grants(self, since: float) -> list[Grant]:
        """The leases that they got."""
        found = self.stack.printed(self, "lease", 4)
        grants = [Grant(int(each[1]), float(each[2]), float(each[3])) for each in found]
        return sorted(grant for grant in grants if grant.asked >= since)

    def waited(self, since: float) -> list[list[Waited]]:
        """How long the threads that stop the robot have waited for a core: those of its bridge, and its own."""
        processes = (list(child.lines) for child in (self.bridge, self.robot))
        return [[one for one in map(_waited, lines) if one is not None and one.at >= since] for lines in processes]

    async def heal(self) -> None:
        """Have all its links pass everything again, and nobody hold its robot."""
        for name in self.links:
            await self.stack.links.ask(link=name, mode="pass")
        for device in self.devices:
            await device.ask(do="wish", speed=None)
            await device.ask(do="release")

    async def set_link(self, where: str, mode: str, way: str = "both", seconds: float = 0.0) -> dict[str, float]:
        """Have one of its links do something; the times just before and after it does."""
        return await self.stack.links.ask(link=f"{where} {self.number}", mode=mode, way=way, seconds=seconds)


class Stack:
    """All of it."""

    def __init__(self, folder: Path, processes: Processes, security: dict[str, Any]) -> None:
        self.folder, self.processes, self._security = folder, processes, security
        self.near = system.free_multicast_url()
        self.console_port, self.server_port = system.free_tcp_port(), system.free_tcp_port()
        self.lanes: list[Lane] = []
        self.links: Controlled
        self.server: Child
        self.console: Child
        self._devices: dict[int, list[Child]] = {}

    def write_fleet(self, name: str, url: str) -> Path:
        """The fleet's file, for one end of the links."""
        raw = {
            "version": 1,
            "pubsub": {"url": url, "interface": "lo", "receive_timeout_s": 6, **self._security},
            "server": {"port": self.server_port, "trust_all_clients": True},
            "bridges": {lane.bridge_name: lane.bridge_config for lane in self.lanes},
            "robots": {lane.robot_name: lane.robot_config for lane in self.lanes},
        }
        path = self.folder / name
        path.write_text(json.dumps(raw))
        return path

    def start(self, pages: Collection[int]) -> None:
        """Start everything, and wait until each process says that it is ready; `pages` are lanes with a browser."""
        fleet = self.write_fleet("fleet.json", self.near)
        config = load(fleet, {})
        keys = KeyFolder(self.folder / "keys")
        for group_id in all_groups(config):
            keys.write(KeyFile.new(group_id, SecurityPolicy.AES256_CTR, 3600.0, time.time()))
        users = UserStore(self.folder / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.path.parent.mkdir(parents=True, exist_ok=True)
        users.add(*OPERATOR, Role.OPERATOR)
        users.add(*ENGINEER, Role.ENGINEER)
        links = self.folder / "links.json"
        links.write_text(json.dumps({name: one for lane in self.lanes for name, one in lane.links.items()}))
        self.links = self.controlled("links", PROGRAMS / "links.py", links)
        for lane in self.lanes:
            lane.start_robot()
            lane.start_bridge()
        self.server = self.processes.fork(INTEGRATION / "run_server.py", fleet)
        self.console = self.processes.start(
            sys.executable, "-m", "ua_fleet.cli", "console", "--config", self._console_settings(), "--json"
        )
        self.links.child.wait_for("ready", 60)
        self.server.wait_for("opc.tcp://", 60)
        self.console.wait_for('"ready"', 60)
        for lane in self.lanes:
            if lane.number in pages:
                lane.start_page()
            lane.start_engineer()
            lane.start_tab()
            lane.engineer.child.wait_for("ready", 60)
            lane.robot.wait_for("ready", 60)
            lane.bridge.wait_for("ready", 60)

    def controlled(self, name: str, program: Path, *arguments: str | Path) -> Controlled:
        """Begin to start a program that is told what to do, when it has said `ready`."""
        path = self.folder / f"{name}.sock"
        path.unlink(missing_ok=True)
        return Controlled(self.processes.fork(program, path, *arguments), path)

    def device(
        self, lane: Lane, user: tuple[str, str], console_port: int, server_port: int, *, program: str = "tab.py"
    ) -> Controlled:
        """Start a device of somebody."""
        settings = {
            "console": f"http://127.0.0.1:{console_port}",
            "server": f"opc.tcp://127.0.0.1:{server_port}/ua_fleet",
            "fleet": f"lane{lane.number}" if user == OPERATOR else "plain",
            "robot": lane.robot_name,
            "teleoperation": lane.teleoperation,
            "user": user[0],
            "password": user[1],
            "speed": SPEED,
            "identity": str(self.folder / "identity"),
        }
        devices = self._devices.setdefault(lane.number, [])
        name = f"device{lane.number}-{len(devices)}"
        made = self.controlled(name, PROGRAMS / program, json.dumps(settings))
        devices.append(made.child)
        return made

    def printed(self, lane: Lane, what: str, words: int) -> Sequence[Sequence[str]]:
        """What the devices of a lane have printed, also those that were killed, perhaps in the middle of a line."""
        found = [line.split() for child in self._devices[lane.number] for line in list(child.lines)]
        return [each for each in found if len(each) == words and each[0] == what]

    def _console_settings(self) -> Path:
        ports = {f"lane{lane.number}": lane.ports["server"] for lane in self.lanes} | {"plain": self.server_port}
        settings = {
            "listen": f"127.0.0.1:{self.console_port}",
            "fleets": {name: {"endpoint": f"opc.tcp://127.0.0.1:{port}/ua_fleet"} for name, port in ports.items()},
            "state_dir": str(self.folder / "console"),
        }
        path = self.folder / "console.json"
        path.write_text(json.dumps(settings))
        return path

    def end_all(self) -> None:
        """Have all processes end at the same time, since each takes its while."""
        for child in self.processes.children:
            if child.process.poll() is None:
                os.killpg(child.process.pid, signal.SIGTERM)
                child.go_on()

    async def close(self) -> None:
        """Close what belongs to an event loop that ends."""
        for controlled in (self.links, *[each for lane in self.lanes for each in lane.devices]):
            await controlled.close()


@contextmanager
def running_stack(folder: Path, pages: Collection[int] = (), security: dict[str, Any] = SECURED) -> Generator[Stack]:
    """All processes, while the context lasts. The first lane is ROS 1, the others ROS 2; `pages` have a browser too."""
    with ExitStack() as context:
        processes = context.enter_context(Processes())
        stack = Stack(folder, processes, security)
        master = Master(folder, processes)
        master.appear()
        for number in range(LANES):
            space = 1 if number == 0 else context.enter_context(system.ros_domain())
            stack.lanes.append(Lane(stack, number, space, master if number == 0 else None))
        context.callback(stack.end_all)
        stack.start(pages)
        yield stack
