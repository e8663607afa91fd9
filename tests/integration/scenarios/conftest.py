"""A whole server and a fleet of machines with one skill, each with a bridge of its own as a process."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import Machine
from tests.integration.server_model.harness import OPERATOR, Running, connected, serving, ua, until
from tests.system import Child, Processes
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.server.mutual_trust import introduce_bridge
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy

FOLDER: Final = Path(__file__).parent
ROBOTS: Final = ("left", "middle", "right")
ENGINEER: Final = ("erna", "engineer-1")
SECOND: Final = ("otto", "operate-2")
_ARGUMENTS: Final = {
    "work": {"type": "String", "default": "weld"},
    "seconds": {"type": "Double", "unit": "s", "range": [0, 60], "default": 0},
}
_RESULTS: Final = {"done": {"type": "String"}, "seconds": {"type": "Double", "unit": "s"}}


class Called(NamedTuple):
    """What a Method returned."""

    outputs: list[Any]
    status: int
    message: str


class Plant:
    """The folder of the fleet. `pubsub` changes that part of it; with message security `prepare` comes first."""

    def __init__(
        self, folder: Path, url: str, port: int, processes: Processes, mode: str, pubsub: Mapping[str, Any] = {}
    ) -> None:
        self.folder, self._processes = folder, processes
        self.machines = {robot: Machine(folder / robot) for robot in ROBOTS}
        skill = {"needs": ["weld"], "arguments": _ARGUMENTS, "results": _RESULTS, "timeout_s": 30}
        raw: dict[str, Any] = {
            "version": 1,
            "server": {"port": port, "trust_all_clients": True},
            "pubsub": {"security": "none", "url": url, "keep_alive_s": 0.2, "receive_timeout_s": 0.8, **pubsub},
            "bridges": {
                f"{robot}_cell": {"kind": "virtual", "space": 300 + number, "status_id": 900 + number}
                for number, robot in enumerate(ROBOTS)
            },
            "robots": {
                robot: {
                    "bridge": f"{robot}_cell",
                    "capacities": ["weld"],
                    "skill_status_id": 1200 + number,
                    "skills": {"work": {"id": 1100 + number, **skill}},
                }
                for number, robot in enumerate(ROBOTS)
            },
            "resilience": {"mode": mode, "limit_s": 60, "silence_s": 4.0},
        }
        raw["robots"]["left"]["data"] = {"go_on": {"id": 1300, "type": "Int32", "origin": "server", "initial": 1}}
        (folder / "fleet.json").write_text(json.dumps(raw))
        self.config = FleetConfig.model_validate(raw)
        (folder / "scenarios").mkdir()

    def declare(self, change: Callable[[dict[str, Any]], None]) -> None:
        """Change the fleet before its server is started."""
        path = self.folder / "fleet.json"
        raw = json.loads(path.read_text())
        change(raw)
        path.write_text(json.dumps(raw))
        self.config = FleetConfig.model_validate(raw)

    def scenario(self, name: str, steps: str, head: str = "") -> None:
        """Write a scenario's file."""
        text = f"version: 1\nname: {name}\ndescription: for a test\n{head}steps:\n{steps}"
        (self.folder / "scenarios" / f"{name}.yaml").write_text(text)

    async def prepare(self) -> None:
        """Make users, and what message security needs: bridges that the server knows, or key files."""
        self.users()
        keys = self.config.pubsub.keys
        if keys.source == "service":
            for name in self.config.bridges:
                await introduce_bridge(self.config, self.folder, name)
        else:
            for group_id in all_groups(self.config):
                key_file = KeyFile.new(group_id, SecurityPolicy.named(keys.policy), 3600.0, time.time())
                KeyFolder(self.folder / keys.folder).write(key_file)

    def start_bridge(self, robot: str, fleet: str = "fleet.json") -> Child:
        """Start a robot's bridge; it says `ready` when it works."""
        return self._start(FOLDER / "robot_bridge.py", self.folder / fleet, robot, self.folder / robot)

    def bridge(self, robot: str) -> Child:
        """Start a robot's bridge, and wait until it works."""
        child = self.start_bridge(robot)
        child.wait_for("ready")
        return child

    def start_server(self) -> Child:
        """Start the server as a process of its own; it says its URL when it serves."""
        return self._start(FOLDER / "server_process.py", self.folder / "fleet.json")

    def server_process(self) -> Child:
        """Start the server as a process of its own, and wait until it serves."""
        child = self.start_server()
        child.wait_for("opc.tcp://")
        return child

    def client(self, user: tuple[str, str] = OPERATOR) -> AbstractAsyncContextManager[Client]:
        """A session with the server that is a process of its own."""
        return connected(f"opc.tcp://127.0.0.1:{self.config.server.port}/ua_fleet", self.folder, user)

    def users(self) -> None:
        """Make users beside those of the harness."""
        users = UserStore(self.folder / self.config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
        users.path.parent.mkdir(parents=True, exist_ok=True)
        users.add(*ENGINEER, Role.ENGINEER, replace_existing=True)
        for operator in (OPERATOR, SECOND):
            users.add(*operator, Role.OPERATOR, replace_existing=True)

    def _start(self, program: Path, *arguments: str | Path) -> Child:
        return self._processes.fork(program, *arguments)

    @asynccontextmanager
    async def server(self) -> AsyncGenerator[Running]:
        """The server in the test's process, while the context lasts."""
        self.users()
        async with serving(self.folder, self.config) as running:
            yield running

    def told(self) -> list[tuple[str, str]]:
        """What robots were told to do, by the time at which it began."""
        jobs = [(job.began, robot, job.work) for robot, machine in self.machines.items() for job in machine.told()]
        return [(robot, work) for _, robot, work in sorted(jobs)]


async def says(child: Child, text: str, timeout_s: float = 60) -> None:
    """Wait until a process says something, while the test's own loop runs."""
    async with asyncio.timeout(timeout_s):
        while not any(text in line for line in child.lines):
            assert child.process.poll() is None, "\n".join(child.lines)
            await asyncio.sleep(0.02)


def texts(values: Sequence[str] = ()) -> Any:
    return ua.Variant(list(values), ua.VariantType.String, None, True)


async def call(client: Client, owner: str, name: str, *arguments: Any) -> Called:
    """Call a Method of Scenarios, Resilience or Faults."""
    node = client.get_node(f"ns=2;s=Fleet.{owner}")
    outputs: Any = await node.call_method(f"3:{name}", *arguments)
    return Called(outputs[:-2], outputs[-2], outputs[-1])


async def run(client: Client, name: str, parameters: dict[str, str] | None = None) -> str:
    """Start a run; its id."""
    given = parameters or {}
    called = await call(client, "Scenarios", "Run", name, texts(list(given)), texts(list(given.values())))
    assert called.status == 0, called.message
    run_id: str = called.outputs[0]
    return run_id


async def value(client: Client, path: str) -> Any:
    return await client.get_node(f"ns=2;s=Fleet.{path}").read_value()


async def run_is(client: Client, run_id: str, *states: str) -> str:
    """Wait until a run is in a state."""

    async def read() -> Any:
        return await value(client, f"Scenarios.Runs.{run_id}.State")

    state: str = await until(read, lambda found: found in states, timeout_s=60)
    return state


async def open_decision(client: Client) -> str:
    """Wait for an open decision; its id."""
    folder = client.get_node("ns=2;s=Fleet.Resilience.Decisions")

    async def read() -> Any:
        for node in await folder.get_children():
            name = (await node.read_browse_name()).Name
            if await value(client, f"Resilience.Decisions.{name}.State") == "open":
                return name
        return None

    found: str = await until(read, lambda name: name is not None, timeout_s=60)
    return found


async def all_heard(client: Client) -> None:
    """Wait until the server hears all robots."""

    async def read() -> Any:
        return [await client.get_node(f"ns=2;s=Robots.{robot}.State").read_value() for robot in ROBOTS]

    await until(read, lambda states: 0 not in states, timeout_s=60)


class Seen:
    """Events of the Server object, by a subscription."""

    def __init__(self) -> None:
        self.events: list[Any] = []
        self.subscription_id = 0

    def event_notification(self, event: Any) -> None:
        """Called by asyncua."""
        self.events.append(event)

    async def wait_for(self, text: str) -> Any:
        """The first event whose message has a text in it."""
        async with asyncio.timeout(60):
            while True:
                for event in self.events:
                    if text in event.Message.Text:
                        return event
                await asyncio.sleep(0.02)


@asynccontextmanager
async def watching(client: Client, *types: int) -> AsyncGenerator[Seen]:
    """Watch the Server's events with the fields of some types of ours."""
    seen = Seen()
    subscription = await client.create_subscription(50, seen)
    seen.subscription_id = subscription.subscription_id or 0
    for kind in types:
        await subscription.subscribe_events(client.nodes.server, client.get_node(f"ns=3;i={kind}"))
    yield seen
    await subscription.delete()


@pytest.fixture
def plant(request: pytest.FixtureRequest, tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Plant:
    """A fleet; the mode of resilience may be given as the parameter."""
    return Plant(tmp_path, udp_url, tcp_port, processes, getattr(request, "param", "operator"))
