"""The processes of the benchmark `hand_over`.

    python -m benchmarks._hand_over server FLEET           the server
    python -m benchmarks._hand_over bridge FLEET NAME      a bridge whose robot takes TASK_S for everything
    python -m benchmarks._hand_over client FLEET URL       runs scenarios, and asks an echo

A bridge answers the line `taken` with the monotonic times at which its robot was called and was done since the last
one. The client answers `orchestrated` and `carried` with how the run has ended, and `echo N BYTES PORT` with the
microseconds of N round trips.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
from collections.abc import AsyncGenerator, Sequence
from pathlib import Path

import structlog

from benchmarks._actions import PAUSE_S, EchoClient
from benchmarks.hand_over import PASSWORD, SCENARIO_NAME, SKILL, TASK_S, USER
from tests.contract.virtual import Bus, VirtualDriver
from ua_fleet.bridge import Driver, DriverStatus, Execution, ExecutionEnded, Inlet, Skill, SkillTarget
from ua_fleet.bridge.runner import run_bridge
from ua_fleet.carrier import carrier_of
from ua_fleet.client import ClientIdentity, FleetClient, ScenarioClient
from ua_fleet.config.schema import FleetConfig
from ua_fleet.server.app import run_server
from ua_fleet.topics import Topic
from ua_fleet.transport.udp import UdpTransport
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData


class Noting(Driver):
    """A driver whose robot takes TASK_S for everything, and notes when it was called and was done."""

    def __init__(self, config: FleetConfig, name: str) -> None:
        bus, ns = Bus(), config.fleet.namespace_index
        bus.is_up = True
        space = config.bridges[name].space
        self._base = VirtualDriver(space, bus)
        self._inlet: Inlet | None = None
        (robot,) = [one for one, robot in config.robots.items() if robot.bridge == name]
        declared = config.robots[robot]
        status_id, skill_id = declared.skill_status_id, declared.skills[SKILL].id
        assert status_id is not None
        assert skill_id is not None
        target = SkillTarget(1, robot, Topic(space, ns, status_id))
        self._skills = (Skill(Topic(space, ns, skill_id), SKILL, (target,)),)
        self.called: list[float] = []
        self.done: list[float] = []

    async def start(self, inlet: Inlet) -> None:
        self._inlet = inlet
        await self._base.start(inlet)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        return self._base.publish(topic, metadata, message)

    def status(self) -> DriverStatus:
        return self._base.status()

    async def stop(self) -> None:
        await self._base.stop()

    def skills(self) -> Sequence[Skill]:
        return self._skills

    def execute(self, execution: Execution) -> None:
        self.called.append(time.monotonic())
        asyncio.get_running_loop().call_later(TASK_S, self._end, execution.execution_id)

    def _end(self, execution_id: bytes) -> None:
        assert self._inlet is not None
        self.done.append(time.monotonic())
        self._inlet.put(ExecutionEnded(execution_id))

    def query(self, execution: Execution) -> None: ...


async def bridge(config: FleetConfig, folder: Path, name: str) -> None:
    driver, state_dir = Noting(config, name), folder / config.state_dir_of(name)
    running = asyncio.ensure_future(
        run_bridge(
            config,
            name,
            driver,
            UdpTransport(config.pubsub.url, "lo"),
            state_dir=state_dir,
            ready=lambda: print("ready", flush=True),
            carry=carrier_of(config, name, state_dir),
        )
    )
    async for _ in lines():
        print(json.dumps([driver.called, driver.done]), flush=True)
        driver.called.clear()
        driver.done.clear()
    running.cancel()
    await asyncio.wait([running])


async def server(config: FleetConfig, folder: Path) -> None:
    running = asyncio.ensure_future(run_server(config, folder, ready=lambda url: print("ready", url, flush=True)))
    await asyncio.to_thread(sys.stdin.read)
    running.cancel()
    await asyncio.wait([running])


async def client(folder: Path, url: str) -> None:
    identity = ClientIdentity(folder / "client")
    async with FleetClient.connect(url, user=USER, password=PASSWORD, identity=identity, timeout_s=30) as connected:
        scenarios, echoing = ScenarioClient(connected), EchoClient()
        print("ready", flush=True)
        async for line in lines():
            what, *numbers = line.split()
            if what != "echo":
                run_id = await scenarios.run(SCENARIO_NAME, carried=what == "carried")
                async for _ in scenarios.follow(run_id):
                    pass
                info = await scenarios.run_info(run_id)
                print(json.dumps([info.state, info.reason]), flush=True)
                continue
            count, size, port = map(int, numbers)
            times: list[float] = []
            for _ in range(count):
                await asyncio.sleep(PAUSE_S)
                started = time.perf_counter()
                await echoing.ask(bytes(size), port)
                times.append((time.perf_counter() - started) * 1e6)
            print(json.dumps(times), flush=True)


async def lines() -> AsyncGenerator[str]:
    """Each line of the standard input."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := (await reader.readline()).decode():
        yield line


def main(what: str, fleet: str, *others: str) -> None:
    path = Path(fleet)
    config = FleetConfig.model_validate_json(path.read_text())
    if what == "server":
        asyncio.run(server(config, path.parent))
    elif what == "bridge":
        asyncio.run(bridge(config, path.parent, *others))
    else:
        asyncio.run(client(path.parent, *others))


if __name__ == "__main__":
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING)
    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    main(*sys.argv[1:])
