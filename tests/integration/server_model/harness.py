"""A whole server in the test's event loop, a bridge's PubSub side beside it, and encrypted clients."""

from __future__ import annotations

import asyncio
import importlib
import json
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext
from pathlib import Path
from typing import Any, Final

from asyncua.client.client import Client
from asyncua.crypto import security_policies

from tests.integration.peer import Peer
from tests.standard_space import quick_start
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.endpoint.certificates import CertificateFiles, create_certificate
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.pubsub.subscriber import LoopRule
from ua_fleet.server.app import run_server
from ua_fleet.topics import Topic, loop_verdict

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")

SPACE: Final = 2
SPEED: Final = Topic(SPACE, 2, 1001)
GOAL: Final = Topic(0, 2, 1002)
VELOCITY: Final = Topic(0, 2, 1003)
POSE: Final = Topic(SPACE, 2, 1004)
STATUS: Final = Topic(SPACE, 2, 1900)
OPERATOR: Final = ("oscar", "operate-1")
OBSERVER: Final = ("olga", "observe-1")
ENGINEER: Final = ("erna", "engineer-1")
CLIENT_URI: Final = "urn:test:client"
_BASIC: Final[Any] = security_policies.SecurityPolicyBasic256Sha256
_certificate: list[bytes] = []
"""Of the tests' clients, with its key."""

ROBOTS: Final[Mapping[str, Any]] = {
    "rover": {
        "bridge": "mobile_side",
        "description": "A rover",
        "capacities": ["mobile"],
        "data": {
            "speed": {"id": 1001, "type": "Double", "unit": "m/s", "range": [-2, 2]},
            "goal": {"id": 1002, "type": "Double", "origin": "server", "range": [0, 1], "initial": 0},
            "velocity": {
                "id": 1003,
                "origin": "server",
                "fields": {"linear.x": {"type": "Double"}, "angular.z": {"type": "Double"}},
                "sink": {"topic": "/cmd_vel", "type": "geometry_msgs/Twist"},
            },
            "pose": {"id": 1004, "fields": {"x": {"type": "Double"}, "frame": {"type": "String"}}},
        },
    }
}


def fleet_config(
    url: str,
    port: int,
    *,
    robots: Mapping[str, Any] = ROBOTS,
    namespaces: Sequence[str] = (),
    history: Mapping[str, Any] | None = None,
    **server: Any,
) -> FleetConfig:
    """A fleet with one robot that has a source of each kind, and short times."""
    raw = {
        "version": 1,
        "fleet": {"namespaces": namespaces},
        "server": {"port": port, "trust_all_clients": True, **server},
        "pubsub": {"security": "none", "url": url, "keep_alive_s": 0.2, "receive_timeout_s": 0.8},
        "bridges": {"mobile_side": {"kind": "ros2", "space": SPACE, "status_id": STATUS.id}},
        "robots": robots,
        **({} if history is None else {"history": history}),
    }
    return load_content(json.dumps(raw).encode(), "fleet.json", {}, allow_missing_ids=True)


class Running:
    """A server that runs, and the peer that plays its bridge."""

    def __init__(self, url: str, peer: Peer, folder: Path) -> None:
        self.url = url
        self.peer = peer
        self.folder = folder

    def client(self, user: tuple[str, str] = OPERATOR, *, most_bytes: int = 0) -> AbstractAsyncContextManager[Client]:
        """An encrypted session of a user, whose client takes messages of so many bytes; 0 for any."""
        return connected(self.url, self.folder, user, most_bytes=most_bytes)


@asynccontextmanager
async def connected(url: str, folder: Path, user: tuple[str, str], *, most_bytes: int = 0) -> AsyncGenerator[Client]:
    """An encrypted session of a user; the client's certificate is kept in `folder`."""
    client = Client(url, timeout=60, watchdog_intervall=60)
    client.max_messagesize = most_bytes
    client.application_uri = CLIENT_URI
    files = CertificateFiles(folder / "client.der", folder / "client.pem")
    if not files.certificate.exists():
        if _certificate:  # one for all, since a key takes its time
            files.certificate.write_bytes(_certificate[0])
            files.private_key.write_bytes(_certificate[1])
        else:
            create_certificate(files, application_uri=CLIENT_URI, common_name="client")
            _certificate[:] = files.certificate.read_bytes(), files.private_key.read_bytes()
    await client.set_security(
        _BASIC, str(files.certificate), str(files.private_key), mode=ua.MessageSecurityMode.SignAndEncrypt
    )
    client.set_user(user[0])
    client.set_password(user[1])
    async with client:
        yield client


@asynccontextmanager
async def serving(
    folder: Path, config: FleetConfig, *, rule: LoopRule = loop_verdict, start_s: float = 30, quick: bool = True
) -> AsyncGenerator[Running]:
    """A server that serves while the context lasts, and whose end is clean; it has `start_s` to start.

    Without `quick` it makes the standard's nodes itself, and has the garbage collected before.
    """
    users = UserStore(folder / config.server.state_dir / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(parents=True, exist_ok=True)
    users.add(*OPERATOR, Role.OPERATOR, replace_existing=True)
    users.add(*OBSERVER, Role.OBSERVER, replace_existing=True)
    users.add(*ENGINEER, Role.ENGINEER, replace_existing=True)
    ready: asyncio.Future[str] = asyncio.get_running_loop().create_future()
    async with Peer.at(config.pubsub.url, SPACE) as peer:
        with quick_start() if quick else nullcontext():
            task = asyncio.ensure_future(run_server(config, folder, ready=ready.set_result, rule=rule))
            waited: list[asyncio.Future[Any]] = [task, ready]
            await asyncio.wait(waited, return_when=asyncio.FIRST_COMPLETED, timeout=start_s)
        if not ready.done():
            task.result()
        try:
            yield Running(ready.result(), peer, folder)
            assert not task.done(), task.exception()
        finally:
            task.cancel()
            await asyncio.wait([task])


async def until(read: Callable[[], Any], expected: Callable[[Any], bool], timeout_s: float = 60) -> Any:
    """Read until what is read is as expected, which Bad never is; the last that was read."""
    last = None
    try:
        async with asyncio.timeout(timeout_s):
            while True:
                try:
                    last = await read()
                except ua.UaStatusCodeError as error:
                    last = error
                else:
                    if expected(last):
                        return last
                await asyncio.sleep(0.02)
    except TimeoutError:
        raise AssertionError(f"still {last!r}") from None


def reader(client: Client, node_id: str) -> Callable[[], Any]:
    """Reads a node's DataValue, Bad or not."""
    node = client.get_node(node_id)

    async def read() -> Any:
        return await node.read_data_value(raise_on_bad_status=False)

    return read
