"""A plugged-in sensor in a whole fleet: server and bridge as processes, secured, and a client that subscribes."""

# pyright: reportPrivateUsage=false, reportPrivateImportUsage=false

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import time
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

import pytest
from asyncua import ua

from tests.plugged_device import PtyDevice
from tests.system import Child, Processes, clean_environment
from tests.waiting import until
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.client.scenarios import RunInfo, ScenarioClient
from ua_fleet.endpoint.users import USERS_FILE, Role, ScryptCost, UserStore
from ua_fleet.errors import SkillRejected
from ua_fleet.values import StatusCode

USER, PASSWORD = "oscar", "operate-1"
TEMPERATURE = "ns=2;s=Robots.pioneer_pc.Data.temperature"

PERIOD_S = 0.05
FLEET = r"""
version: 1
server: {port: PORT, trust_all_clients: true}
pubsub:
  security: sign_and_encrypt
  url: URL
  keep_alive_s: 0.2
  receive_timeout_s: 0.8
  repeat_interval_s: 1
  keys: {source: files}
bridges:
  pc: {kind: plugged, space: 300, status_id: 1, devices: {thermometer: {path: PATH}}}
  cell: {kind: tcp, space: 301, status_id: 2, interpreter: {connect: "127.0.0.1:9"}}
robots:
  pioneer: {bridge: cell, capacities: [mobile]}
  pioneer_pc:
    bridge: pc
    mounted_on: pioneer
    skill_status_id: 1902
    data:
      temperature:
        id: 10
        type: Double
        unit: "°C"
        gives: [temperature]
        source: {device: thermometer, line: "T={value}", ask: "T?\n", period_s: PERIOD_S}
    skills:
      read_temperature:
        id: 1900
        needs: [temperature]
        immediate: true
        timeout_s: 2
        results: {value: {type: Double}}
        via: {read: temperature}
"""


class Fleet:
    """The fleet's folder, its thermometer and its client."""

    def __init__(self, folder: Path, processes: Processes, port: int) -> None:
        self.folder, self._processes, self._port = folder, processes, port
        self.degrees = 21.5
        self.thermometer = PtyDevice(folder / "thermometer", self._answer)
        self.bridge = self.server = self.start("keys", "create")
        assert self.bridge.process.wait(60) == 0

    def _answer(self, device: PtyDevice, line: str) -> None:
        if line == "T?":
            device.say(f"T={self.degrees}\n")

    def start(self, *arguments: str) -> Child:
        environment = clean_environment(PYTHONUNBUFFERED="1", UA_FLEET_CONFIG=str(self.folder / "fleet.yaml"))
        return self._processes.start(sys.executable, "-m", "ua_fleet.cli", *arguments, env=environment)

    def start_bridge(self) -> None:
        self.bridge = self.start("bridge", "pc")
        self.bridge.wait_for("ready")

    def start_server(self) -> None:
        self.server = self.start("serve")
        self.server.wait_for("ready")

    @contextlib.asynccontextmanager
    async def client(self) -> AsyncGenerator[FleetClient]:
        url, identity = f"opc.tcp://127.0.0.1:{self._port}/ua_fleet", ClientIdentity(self.folder / "identity")
        async with FleetClient.connect(url, user=USER, password=PASSWORD, identity=identity) as client:
            yield client

    @property
    def asked(self) -> int:
        """How often the thermometer was asked."""
        return len(self.thermometer.heard)

    async def rests(self, within_s: float) -> None:
        """Wait until it is asked no more, and see that it stays so."""
        deadline = time.monotonic() + within_s
        while True:
            before = self.asked
            await asyncio.sleep(0.3)
            if self.asked == before:
                break
            assert time.monotonic() < deadline, "the thermometer is still asked"
        before = self.asked
        await asyncio.sleep(0.5)
        assert self.asked == before


@pytest.fixture
async def fleet(tmp_path: Path, udp_url: str, tcp_port: int, processes: Processes) -> AsyncGenerator[Fleet]:
    text = FLEET.replace("PORT", str(tcp_port)).replace("URL", udp_url).replace("PERIOD_S", str(PERIOD_S))
    (tmp_path / "fleet.yaml").write_text(text.replace("PATH", str(tmp_path / "thermometer")))
    users = UserStore(tmp_path / "state" / USERS_FILE, ScryptCost(2**8, 8, 1))
    users.path.parent.mkdir(mode=0o700)
    users.add(USER, PASSWORD, Role.OPERATOR)
    made = Fleet(tmp_path, processes, tcp_port)
    made.start_server()
    made.start_bridge()
    with made.thermometer:
        yield made


async def status_of(client: FleetClient) -> int:
    (reading,) = await client.read(["ns=2;i=10"])
    return int(reading.status)


async def has_status(client: FleetClient, wanted: int, timeout_s: float = 60) -> None:
    async with asyncio.timeout(timeout_s):
        while await status_of(client) != wanted:
            await asyncio.sleep(0.05)


async def test_it_is_read_while_somebody_subscribes_and_not_otherwise(fleet: Fleet) -> None:
    async with fleet.client() as client:
        await has_status(client, StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
        await fleet.rests(5)
        assert fleet.asked == 0
        values: list[object] = []
        async with asyncio.timeout(60):
            async for change in client.watch(["ns=2;i=10"]):
                values.append(change.value)
                if change.value == 21.5:
                    fleet.degrees = 22.5
                if change.value == 22.5:
                    break
        await has_status(client, StatusCode.UNCERTAIN_LAST_USABLE_VALUE)
        await fleet.rests(5)
        assert (await client.read(["ns=2;i=10"]))[0].value == 22.5


async def test_a_reading_on_request_and_the_capacity_of_what_is_plugged_in(fleet: Fleet) -> None:
    async with fleet.client() as client:
        told = Messages()
        subscription: Any = await client._client.create_subscription(50, told)
        await subscription.subscribe_events(ua.ObjectIds.Server, ua.ObjectIds.GeneralModelChangeEventType)

        async def capacities() -> list[str]:
            both = await client.read([f"ns=2;s=Robots.{name}.Capacities" for name in ("pioneer", "pioneer_pc")])
            return [", ".join(reading.value or ()) for reading in both]

        async def become(wanted: list[str]) -> None:
            async with asyncio.timeout(60):
                while await capacities() != wanted:
                    await asyncio.sleep(0.05)

        async def hear(text: str) -> None:
            await until(lambda: text in told.messages, text)

        await become(["mobile, temperature", "temperature"])
        began = time.monotonic()
        assert await client.call_skill("pioneer_pc", "read_temperature") == {"value": 21.5}
        assert 1 <= fleet.asked <= 1 + (time.monotonic() - began) / PERIOD_S
        await fleet.rests(5)
        fleet.thermometer.unplug()
        await become(["mobile", ""])
        await hear("robot pioneer cannot do any more: temperature (pioneer_pc.temperature is not there)")
        await has_status(client, StatusCode.BAD_NO_COMMUNICATION)
        with pytest.raises(SkillRejected, match=r"pioneer_pc\.temperature is not plugged in"):
            await client.call_skill("pioneer_pc", "read_temperature")
        fleet.degrees = 23.0
        fleet.thermometer.plug()
        await hear("robot pioneer can do now: temperature")
        await become(["mobile, temperature", "temperature"])
        assert await client.call_skill("pioneer_pc", "read_temperature") == {"value": 23.0}


async def test_a_stream_ends_with_its_server_and_goes_on_with_its_bridge(fleet: Fleet) -> None:
    async with fleet.client() as client:
        subscribed = client.watch(["ns=2;i=10"])
        async with asyncio.timeout(60):
            async for change in subscribed:
                if change.value == 21.5:
                    break
        watching = asyncio.create_task(follow(client))
        await until(lambda: fleet.asked > 20, "the stream")
        fleet.bridge.end(signal.SIGKILL)
        await fleet.rests(3)
        asked = fleet.asked
        fleet.start_bridge()
        await until(lambda: fleet.asked > asked + 5, "the stream after the bridge's return")
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        watching = asyncio.create_task(follow(client))
        await until(lambda: fleet.asked > asked + 20, "the stream")
        fleet.server.end(signal.SIGKILL)
        await fleet.rests(4)
        watching.cancel()
        await asyncio.gather(watching, return_exceptions=True)
        asked = fleet.asked
        fleet.start_server()
        await asyncio.sleep(1.5)
        assert fleet.asked == asked, "nobody has subscribed at the new server"


class Messages:
    """What model changes say."""

    def __init__(self) -> None:
        self.messages: list[str] = []

    def event_notification(self, event: Any) -> None:
        self.messages.append(str(event.Message.Text))


async def follow(client: FleetClient) -> None:
    async for _ in client.watch(["ns=2;i=10"]):
        pass


async def test_a_run_has_what_it_needs_read_and_says_why_nobody_can_do_it(fleet: Fleet) -> None:
    (fleet.folder / "scenarios").mkdir()
    look = "{task: look, skill: read_temperature, capacity: temperature}"
    for name, step in (("warm", f"{{if: temperature > 20, then: [{look}]}}"), ("look", look)):
        (fleet.folder / "scenarios" / f"{name}.yaml").write_text(f"version: 1\nname: {name}\nsteps:\n  - {step}\n")
    async with fleet.client() as client:
        await has_status(client, StatusCode.BAD_WAITING_FOR_INITIAL_DATA)
        assert fleet.asked == 0
        scenarios = ScenarioClient(client)

        async def ended(run_id: str) -> RunInfo:
            async with asyncio.timeout(60):
                while not (info := await scenarios.run_info(run_id)).is_over:
                    await asyncio.sleep(0.05)
            return info

        async def decided(text: str) -> None:
            async with asyncio.timeout(60):
                while True:
                    for decision in await scenarios.decisions():
                        if text in decision.reasons:
                            return
                    await asyncio.sleep(0.05)

        done = await ended(await scenarios.run("warm"))
        assert (done.state, done.robots) == ("done", ("pioneer_pc",)), done
        assert fleet.asked > 0
        await fleet.rests(5)
        fleet.thermometer.unplug()
        await has_status(client, StatusCode.BAD_NO_COMMUNICATION)
        assert await scenarios.validate("look") == []
        run_id = await scenarios.run("look")
        await decided("lacks the capacity temperature now: pioneer_pc.temperature is not there")
        fleet.thermometer.plug()
        async with asyncio.timeout(60):
            while (decision := (await scenarios.decisions())[0]).robots != ("pioneer_pc",):
                await asyncio.sleep(0.05)
        await scenarios.confirm(decision.decision_id, "pioneer_pc")
        done = await ended(run_id)
        assert (done.state, done.robots) == ("done", ("pioneer_pc",)), done
