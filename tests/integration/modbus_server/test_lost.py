"""What a PLC asked for and what might get lost on its way: the end of a command, the last of several values."""

from __future__ import annotations

import asyncio
import json
import struct

import pytest

from tests.integration.modbus_server.conftest import WORK, ModbusPlant, modbus
from tests.integration.modbus_server.test_gateway import message, warmed_up
from tests.integration.server_model.harness import OPERATOR
from ua_fleet.client import ClientIdentity, FleetClient
from ua_fleet.client.fleet_client import Reading
from ua_fleet.config.schema import FleetConfig
from ua_fleet.modbus.words import CommandState

pytestmark = pytest.mark.needs("mbpoll")


async def test_command_that_others_have_pushed_out_ends_as_unknown(plant: ModbusPlant) -> None:
    often = plant.config.pubsub.model_copy(update={"repeat_interval_s": 0.5})
    plant.config = plant.config.model_copy(update={"pubsub": often})
    plant.bridge("left")
    async with plant.server() as running:
        async with plant.device(running) as panel:
            await warmed_up(panel)
            number = await panel.ask_for_work("weld", 3)
            await panel.until(lambda words: words == [number, CommandState.RUNNING], "answer", 2)
        identity = ClientIdentity(plant.folder / "somebody_else")
        async with FleetClient.connect(
            running.url, user=OPERATOR[0], password=OPERATOR[1], identity=identity
        ) as client:
            await asyncio.sleep(0.3)
            for count in range(9):
                await client.call_skill("left", "work", work=f"another {count}", seconds=0)
        async with plant.device(running) as panel:
            assert await panel.ended(number) is CommandState.UNKNOWN
            assert await message(panel) == "the robot tells no more of it"
            following = await panel.command(1, number + 1)
            assert await panel.ended(following) is CommandState.DONE


async def test_value_written_while_the_one_before_is_on_its_way_is_set_too(
    plant: ModbusPlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = FleetClient.write
    is_written = asyncio.Event()

    async def slow(client: FleetClient, address: str, text: str) -> Reading:
        read = await write(client, address, text)
        is_written.set()
        await asyncio.sleep(0.5)
        return read

    monkeypatch.setattr(FleetClient, "write", slow)
    async with plant.server() as running, plant.device(running) as panel:
        await panel.until(lambda words: words[0] == 1, "connected")
        assert await panel.write(60, *struct.unpack(">HH", struct.pack(">i", 5)))
        await is_written.wait()
        assert await panel.write(60, *struct.unpack(">HH", struct.pack(">i", 6)))
        async with asyncio.timeout(60):
            while await panel.read("input", 100, 2) != [0, 6]:
                await asyncio.sleep(0.05)
        assert await panel.read("holding", 60, 2) == [0, 6]


async def test_value_and_robot_that_the_server_lacks_end_nothing(
    plant: ModbusPlant, capsys: pytest.CaptureFixture[str]
) -> None:
    """The device has a newer fleet.yaml than the server."""
    newer = json.loads((plant.folder / "fleet.json").read_text())
    newer["robots"]["left"]["data"]["later"] = {"id": 1301, "type": "Int32"}
    newer["robots"]["later"] = {**newer["robots"]["right"], "skill_status_id": 1299}
    section = modbus()
    more = {
        "values": {"left.later": {"table": "input", "address": 102}, **section["values"]},
        "commands": {"work": {"code": WORK, "robot": "later", "skill": "work"}},
    }
    async with plant.server() as running:
        plant.config = FleetConfig.model_validate(newer)
        async with plant.device(running, **more) as panel:
            await panel.until(lambda words: words[0] == 1, "connected")
            async with asyncio.timeout(60):
                while await panel.read("discrete", 0, 2) != [0, 1]:
                    await asyncio.sleep(0.05)
            assert await panel.read("input", 100, 2) == [0, 1]
            assert await panel.ended(await panel.command(WORK)) is CommandState.REFUSED
            assert await panel.word("connected") == 1
    told = [line for line in capsys.readouterr().out.splitlines() if "cannot be shown" in line]
    assert len(told) == 1
    assert "left.later cannot be shown: there is no node ns=2;i=1301; look with: ua-fleet browse" in told[0]
