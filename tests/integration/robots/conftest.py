"""A server that knows no robots, and a bridge to a machine with skills as a process, over real UDP."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest
from asyncua.client.client import Client

from tests.contract.skilled import QUICK, STATUS, WORK, Machine
from tests.integration.server_model.harness import Running, serving, ua
from tests.system import Child, Processes
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.security import all_groups
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.wire.security import SecurityPolicy

PROGRAM: Final = Path(__file__).parents[1] / "actions" / "skilled_bridge.py"
SPACE: Final = 300
_ARGUMENTS: Final = {
    "work": {"type": "String", "default": "weld", "description": "What to do."},
    "seconds": {"type": "Double", "unit": "s", "range": [0, 10], "description": "How long it takes."},
}
_RESULTS: Final = {"done": {"type": "String"}, "seconds": {"type": "Double", "unit": "s"}}
MACHINE: Final[Mapping[str, Any]] = {
    "description": "Works",
    "capacities": ["weld"],
    "skill_status_id": STATUS,
    "skills": {
        "work": {
            "id": WORK,
            "description": "Works for some time.",
            "needs": ["weld"],
            "arguments": _ARGUMENTS,
            "results": _RESULTS,
            "timeout_s": 20,
            "limits": {"requests_at_once": 2},
        },
        "quick": {"id": QUICK, "arguments": _ARGUMENTS, "results": _RESULTS, "timeout_s": 5, "immediate": True},
    },
}


class Called(NamedTuple):
    """What a Method returned."""

    outputs: list[Any]
    status: int
    message: str


async def invoke(client: Client, request: Any) -> Any:
    """Call one Method; the CallMethodResult."""
    results: Any = await client.uaclient.call([request])
    return results[0]


async def below(client: Client, node_id: str) -> list[Any]:
    """What is below a node."""
    node: Any = client.get_node(node_id)
    return list(await node.get_children_descriptions())


async def call(client: Client, owner: str, name: str, *arguments: Any) -> Called:
    """Call a Method with plain arguments; lists are arrays of texts."""
    given = [
        ua.Variant(value, ua.VariantType.String, is_array=True) if isinstance(value, list) else ua.Variant(value)
        for value in arguments
    ]
    request = ua.CallMethodRequest(
        ua.NodeId.from_string(f"ns=2;s={owner}"), ua.NodeId.from_string(f"ns=2;s={owner}.{name}"), given
    )
    result: Any = await invoke(client, request)
    result.StatusCode.check()
    *outputs, status, message = [variant.Value for variant in result.OutputArguments]
    return Called(outputs, int(status), str(message))


async def register(client: Client, name: str, bridge: str, definition: Mapping[str, Any] | str) -> Called:
    text = definition if isinstance(definition, str) else json.dumps(definition)
    return await call(client, "Fleet", "RegisterRobot", name, bridge, [], "", text)


async def unregister(client: Client, name: str) -> Called:
    return await call(client, "Fleet", "UnregisterRobot", name)


class Yard:
    """The folder of a server without robots, and of a bridge that has one."""

    def __init__(self, folder: Path, url: str, port: int, processes: Processes) -> None:
        self.folder, self._processes, self._url, self._port = folder, processes, url, port
        self.machine = Machine(folder / "machine")
        self.theirs = folder / "theirs"
        self.theirs.mkdir()
        self.write(MACHINE)
        (folder / "scenarios").mkdir()

    def make_keys(self) -> None:
        """Key files for a server and a bridge that are secured."""
        bridges = {"cell": {"kind": "virtual", "space": SPACE, "status_id": 900}}
        config = FleetConfig.model_validate(self._raw({}, bridges, is_secured=True))
        for group_id in all_groups(config):
            key_file = KeyFile.new(group_id, SecurityPolicy.named(config.pubsub.keys.policy), 3600.0, time.time())
            KeyFolder(self.folder / "keys").write(key_file)

    def _raw(
        self, robots: Mapping[str, Any], bridges: Mapping[str, Any], *, is_secured: bool = False, **server: Any
    ) -> dict[str, Any]:
        security: dict[str, Any] = {"security": "none"}
        if is_secured:
            security = {"security": "sign", "keys": {"source": "files", "folder": str(self.folder / "keys")}}
        return {
            "version": 1,
            "server": {"port": self._port, "trust_all_clients": True, **server},
            "pubsub": {**security, "url": self._url, "keep_alive_s": 0.2, "receive_timeout_s": 0.8},
            "bridges": bridges,
            "robots": robots,
        }

    def write(self, machine: Mapping[str, Any], *, is_secured: bool = False) -> None:
        """The bridge's own file."""
        bridges = {"cell": {"kind": "virtual", "space": SPACE, "status_id": 900}}
        robots = {"machine": {"bridge": "cell", **machine}}
        (self.theirs / "fleet.json").write_text(json.dumps(self._raw(robots, bridges, is_secured=is_secured)))

    def bridge(self) -> Child:
        """Start the bridge, and wait until it works."""
        child = self._processes.fork(PROGRAM, self.theirs / "fleet.json", "cell", self.folder / "machine")
        child.wait_for("ready")
        return child

    @asynccontextmanager
    async def server(
        self,
        policy: str = "quarantine",
        robots: Mapping[str, Any] | None = None,
        *,
        knows_bridge: bool = True,
        is_secured: bool = False,
    ) -> AsyncGenerator[Running]:
        """The server, while the context lasts."""
        bridges = {"cell": {"kind": "virtual", "space": SPACE, "status_id": 900}} if knows_bridge else {}
        raw = self._raw(robots or {}, bridges, is_secured=is_secured, unknown_sources=policy)
        config = FleetConfig.model_validate(raw)
        async with serving(self.folder, config) as running:
            yield running


@pytest.fixture
def yard(tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> Yard:
    return Yard(tmp_path, udp_url, tcp_port, processes)
