"""What a bridge says of itself while its values are late, and when they are again of now."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest

from ua_fleet.bridge.driver import DriverStatus, SampleRead
from ua_fleet.bridge.figures import BridgeFigures
from ua_fleet.bridge.inlet import BoundedInlet
from ua_fleet.bridge.lag import LagMeter
from ua_fleet.counters import Counters
from ua_fleet.keys.keeper import KeysKept
from ua_fleet.monitoring import Monitor, ProcessKind
from ua_fleet.monitoring.endpoint import MonitoringEndpoint
from ua_fleet.topics import Topic
from ua_fleet.transport.base import TransportStats

Ask = Callable[[str], Awaitable[tuple[str, str]]]


class Driver:
    """Connected."""

    def status(self) -> DriverStatus:
        return DriverStatus(True, "up")


class Parts:
    """What the figures look at beside the driver: nothing is wrong with it."""

    stats = TransportStats()
    problem = ""
    waits_s = 0.0
    is_secured = False

    @property
    def envelopes(self) -> Parts:
        return self

    def oldest_s(self) -> float:
        return self.waits_s


class Late:
    """The clock of an inlet."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


class Scene:
    def __init__(self) -> None:
        self.monitor, self.lag, self.clock, self.sender = (
            Monitor(ProcessKind.BRIDGE, "cell"),
            LagMeter(),
            Late(),
            Parts(),
        )
        self.inlet = BoundedInlet(asyncio.get_running_loop(), 10, lambda _event: None, clock=self.clock)
        figures = BridgeFigures(
            Counters(),
            Driver(),  # type: ignore[arg-type]
            Parts(),  # type: ignore[arg-type]
            self.inlet,
            KeysKept(),
            self.lag,
            self.sender,  # type: ignore[arg-type]
        )
        figures.tell(self.monitor)


@pytest.fixture
async def scene() -> Scene:
    return Scene()


@pytest.fixture
async def ask(scene: Scene, tmp_path: Path) -> AsyncIterator[Ask]:
    async with MonitoringEndpoint(scene.monitor, "127.0.0.1", 0, tmp_path, key="bridge") as endpoint:

        async def asked(path: str) -> tuple[str, str]:
            reader, writer = await asyncio.open_connection("127.0.0.1", endpoint.port)
            writer.write(f"GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
            head, _, body = (await reader.read()).decode().partition("\r\n\r\n")
            writer.close()
            await writer.wait_closed()
            return head.split("\r\n", 1)[0].split(" ", 1)[1], body.strip()

        yield asked


async def test_a_bridge_whose_values_are_of_now_is_ready(scene: Scene, ask: Ask) -> None:
    scene.inlet.put(SampleRead(Topic(5, 2, 1), (1,), 0))
    scene.clock.now += 0.9
    assert await ask("/readyz") == ("200 OK", "ready: up")
    status, said = await ask("/healthz")
    assert (status, said) == ("200 OK", "ok: lag p99 0.0 ms, oldest waiting 900.0 ms")


@pytest.mark.parametrize("where", ["inlet", "sender"])
async def test_a_bridge_with_a_value_that_waits_is_degraded_and_not_ready_until_it_goes(
    scene: Scene, ask: Ask, where: str
) -> None:
    if where == "inlet":
        scene.inlet.put(SampleRead(Topic(5, 2, 1), (1,), 0))
        scene.clock.now += 1.5
    else:
        scene.sender.waits_s = 1.5
    status, said = await ask("/readyz")
    assert status == "503 Service Unavailable"
    assert said.startswith("not ready: values come late: ")
    assert "the oldest has waited 1.5 s; give the bridge more of a processor" in said
    status, said = await ask("/healthz")
    assert status == "200 OK", "it is alive: to restart it would mend nothing"
    assert said == "degraded: lag p99 0.0 ms, oldest waiting 1500.0 ms"
    scene.sender.waits_s = 0.0
    scene.inlet.open()
    await asyncio.sleep(0)
    assert (await ask("/readyz"))[0] == "200 OK"


async def test_a_bridge_that_was_late_lately_is_not_ready(scene: Scene, ask: Ask) -> None:
    for _ in range(98):
        scene.lag.observe(0.001, asyncio.get_running_loop().time())
    for _ in range(2):
        scene.lag.observe(3.0, asyncio.get_running_loop().time())
    status, said = await ask("/readyz")
    assert status == "503 Service Unavailable"
    assert said.startswith("not ready: values come late: 99 of 100 are sent within 3")
    assert (await ask("/healthz"))[1].startswith("degraded: lag p99 3")
