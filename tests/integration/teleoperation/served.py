"""A whole server and a whole bridge in the test's event loop, over real UDP, with a robot that records setpoints."""

from __future__ import annotations

import asyncio
import importlib
import json
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from tests.integration.server_model.harness import Running, serving, until
from tests.integration.teleoperation.conftest import CARRIER
from ua_fleet.bridge import Driver, DriverStatus, Execution, ExecutionEnded, Inlet, Skill, SkillTarget, run_bridge
from ua_fleet.config.load import load_content
from ua_fleet.config.schema import FleetConfig
from ua_fleet.pubsub.metadata import make_field
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

# asyncua declares UInt32 where it takes an int; tests use it without types.
ua: Any = importlib.import_module("asyncua.ua")

SPACE: Final = 7
DEADMAN_MS: Final = 3000
OBJECT: Final = "ns=2;i=1003"
WAVE: Final = "ns=2;i=1010"
METHODS: Final = {"Acquire": 72071, "Renew": 72072, "Release": 72073, "Drive": 72074}
_SECONDS: Final = make_field("seconds", BuiltinType.DOUBLE)


def fleet(url: str, port: int) -> FleetConfig:
    """A fleet with one robot that is driven by hand. Its times are those of a machine that has much else to do."""
    driven = {**CARRIER["teleoperation"], "deadman_ms": DEADMAN_MS, "robot_timeout_ms": 10_000}
    raw = {
        "version": 1,
        "server": {"port": port, "trust_all_clients": True},
        "pubsub": {"security": "none", "url": url, "interface": "lo", "keep_alive_s": 0.3, "receive_timeout_s": 6},
        "bridges": {"floor": {"kind": "ros2", "space": SPACE, "status_id": 1001}},
        "robots": {"carrier": {"bridge": "floor", **CARRIER, "teleoperation": driven}},
    }
    return load_content(json.dumps(raw).encode(), "fleet.json", {})


class Carrier(Driver):
    """A driver whose robot is the test."""

    def __init__(self) -> None:
        self.written: list[tuple[float, ...]] = []
        self.problem = ""
        self.stopped = 0
        self._inlet: Inlet | None = None

    async def start(self, inlet: Inlet) -> None:
        self._inlet = inlet

    async def stop(self) -> None:
        self.stopped += 1

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        del topic, metadata, message
        return True

    def status(self) -> DriverStatus:
        return DriverStatus(True, "there")

    def skills(self) -> Sequence[Skill]:
        targets = (SkillTarget(1, "carrier", Topic(SPACE, 2, 1009)),)
        return (Skill(Topic(SPACE, 2, 1010), "wave", targets, (_SECONDS,)),)

    def execute(self, execution: Execution) -> None:
        assert self._inlet is not None
        ended = ExecutionEnded(execution.execution_id)
        asyncio.get_running_loop().call_later(execution.values[0], self._inlet.put, ended)

    def query(self, execution: Execution) -> None:
        raise AssertionError(execution)

    def setpoint_problem(self, topic: Topic) -> str:
        del topic
        return self.problem

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        del topic
        self.written.append(values)


class Refused(Exception):
    """A Call was refused."""

    def __init__(self, code: int, reason: str) -> None:
        self.name = ua.StatusCode(ua.UInt32(code)).name
        self.reason = reason
        super().__init__(f"{self.name}: {reason}")


async def call(client: Any, name: str, *arguments: Any, node: str = OBJECT) -> list[Any]:
    """Call one of the Methods; raises Refused with the reason from its DiagnosticInfo."""
    request = ua.CallRequest()
    wanted = ua.CallMethodRequest(ua.NodeId.from_string(node), ua.NodeId(METHODS[name], 3), list(arguments))
    request.Parameters.MethodsToCall = [wanted]
    request.RequestHeader.ReturnDiagnostics = 0x80
    response = ua.ua_binary.struct_from_binary(ua.CallResponse, await client.uaclient.protocol.send_request(request))
    (result,) = response.Results
    if result.StatusCode.value:
        infos = response.DiagnosticInfos
        raise Refused(result.StatusCode.value, infos[0].AdditionalInfo if infos else "")
    return [argument.Value for argument in result.OutputArguments]


class Operator:
    """A session that drives the carrier."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.lease = self.number = self.echo = 0
        self.counters: list[int] = []

    async def acquire(self, *, take_over: bool = False) -> str:
        self.lease, self.echo, taken_from = await call(self.client, "Acquire", ua.Variant(take_over))
        self.number = 0
        return str(taken_from)

    async def renew(self) -> None:
        await call(self.client, "Renew", _uint32(self.lease))

    async def release(self) -> None:
        await call(self.client, "Release", _uint32(self.lease))

    async def drive(self, *values: float) -> None:
        self.number += 1
        await self.send(self.number, self.echo, *values)

    async def send(self, number: int, echo: int, *values: float) -> None:
        doubles = ua.Variant(list(values), ua.VariantType.Double, is_array=True)
        await call(self.client, "Drive", _uint32(self.lease), _uint32(number), _uint32(echo), doubles)

    async def drive_for(self, seconds: float, *values: float) -> None:
        until_at = asyncio.get_running_loop().time() + seconds
        while asyncio.get_running_loop().time() < until_at:
            await self.drive(*values)
            await asyncio.sleep(0.02)

    async def watch(self) -> None:
        """Echo what a subscription with the shortest publishing interval brings."""
        subscription = await self.client.create_subscription(50, self)
        node = self.client.get_node("ns=2;s=1003.Counter")
        await subscription.subscribe_data_change(node, queuesize=1, sampling_interval=0)

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        del node, data
        if value is not None:
            self.counters.append(value)
            self.echo = max(self.echo, value)  # one from before the grant may come after it


def _uint32(value: int) -> Any:
    return ua.Variant(value, ua.VariantType.UInt32)


async def value(client: Any, name: str) -> Any:
    """The value of one of the Variables."""
    return await client.get_node(f"ns=2;s=1003.{name}").read_value()


async def until_value(client: Any, name: str, expected: Any, timeout_s: float = 60.0) -> Any:
    """Wait for a value."""
    node = client.get_node(f"ns=2;s=1003.{name}")

    async def read() -> Any:
        data = await node.read_data_value(raise_on_bad_status=False)
        return data.Value.Value if data.StatusCode.is_good() else data.StatusCode.name

    return await until(
        read, lambda found: bool(expected(found)) if callable(expected) else found == expected, timeout_s
    )


class Floor:
    """The server and its bridge, which may be ended and begun anew."""

    def __init__(self, running: Running, config: FleetConfig) -> None:
        self.running, self._config = running, config
        self.carrier = Carrier()
        self._bridge: asyncio.Task[None] | None = None

    async def begin_bridge(self) -> None:
        ready = asyncio.Event()
        transport = UdpTransport(self._config.pubsub.url, "lo", ttl=1, receive_buffer_bytes=1 << 20)
        folder = self.running.folder / "bridge"
        bridge = run_bridge(self._config, "floor", self.carrier, transport, state_dir=folder, ready=ready.set)
        self._bridge = asyncio.ensure_future(bridge)
        await ready.wait()

    async def end_bridge(self) -> None:
        if self._bridge is not None:
            self._bridge.cancel()
            await asyncio.wait([self._bridge])
            self._bridge = None


@asynccontextmanager
async def floor(folder: Path, config: FleetConfig) -> AsyncGenerator[Floor]:
    """Both, while the context lasts."""
    async with serving(folder, config) as running:
        made = Floor(running, config)
        await made.begin_bridge()
        try:
            async with running.client() as client:
                await until_value(client, "State", 0)
            yield made
        finally:
            await made.end_bridge()
