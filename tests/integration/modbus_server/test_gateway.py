"""mbpoll reads and commands the fleet, through the real server and to the machines and back."""

from __future__ import annotations

import asyncio
import signal
import struct

import pytest

from tests.contract.skilled import ENDLESS_WORK, FAILING_WORK, REFUSED_WORK
from tests.integration.modbus_server.conftest import SHIFT, WORDS, ModbusPlant, Panel
from ua_fleet.modbus.words import CommandState, DecisionOutcome

pytestmark = pytest.mark.needs("mbpoll")


async def warmed_up(panel: Panel) -> None:
    """Wait until the robot can be commanded: its bridge has just been started."""
    async with asyncio.timeout(60):
        await panel.until(lambda words: words[0] == 1, "connected")
        while await panel.ended(await panel.ask_for_work("warm up", 0)) is not CommandState.DONE:
            await asyncio.sleep(0.1)


async def message(panel: Panel) -> str:
    words = await panel.read("input", WORDS["message"], 20)
    return struct.pack(">20H", *words).split(b"\0")[0].decode()


async def test_values_commands_and_results(plant: ModbusPlant) -> None:
    plant.scenario("shift", "  - {task: one, robot: left, skill: work, arguments: {work: paint}}\n")
    plant.bridge("left")
    async with plant.server() as running, plant.device(running) as panel:
        await warmed_up(panel)
        # Values, and their quality.
        async with asyncio.timeout(60):
            while await panel.read("discrete", 0) != [1]:
                await asyncio.sleep(0.05)
        assert await panel.read("input", 100, 2) == [0, 1]
        # What a PLC sets.
        assert await panel.write(60, 0x0001, 0x0002)
        async with asyncio.timeout(60):
            while await panel.read("input", 100, 2) != [1, 2]:
                await asyncio.sleep(0.05)
        # A skill, with its progress, its end and its results.
        number = await panel.ask_for_work("weld", 7)
        await panel.until(lambda words: words == [number, CommandState.RUNNING], "answer", 2)
        assert await panel.ended(number) is CommandState.DONE
        assert await panel.word("progress") == 100
        done = struct.pack(">8H", *await panel.read("input", 110, 8))
        assert done.rstrip(b"\0") == b"weld"
        assert struct.unpack(">f", struct.pack(">2H", *await panel.read("input", 118, 2)))[0] == pytest.approx(0.7)
        # A scenario.
        assert await panel.ended(await panel.command(SHIFT)) is CommandState.DONE
        # Failures and refusals, each with its reason.
        assert await panel.ended(await panel.ask_for_work(FAILING_WORK, 0)) is CommandState.FAILED
        assert await message(panel) == "the machine broke"
        assert await panel.ended(await panel.ask_for_work(REFUSED_WORK, 0)) is CommandState.REFUSED
        assert await panel.ended(await panel.ask_for_work("weld", 60_000)) is CommandState.REFUSED
        assert "seconds" in await message(panel)
        assert await panel.ended(await panel.command(99)) is CommandState.REFUSED
        assert await message(panel) == "there is no command 99"
        beat = await panel.word("heartbeat")
        await panel.until(lambda words: words[0] != beat, "heartbeat")
    works = [job.work for job in plant.left().told()]
    assert [work for work in works if work != "warm up"] == ["weld", "paint", FAILING_WORK]


async def test_a_number_is_done_once_however_often_it_is_written(plant: ModbusPlant) -> None:
    plant.bridge("left")
    async with plant.server() as running:
        async with plant.device(running) as panel:
            await warmed_up(panel)
            number = await panel.ask_for_work("weld", 10)
            for _ in range(5):
                assert await panel.write(0, number)
            assert await panel.ended(number) is CommandState.DONE
            assert await panel.write(0, number)
            # The device is restarted while a command runs.
            running_number = await panel.ask_for_work("polish", 20)
            await panel.until(lambda words: words == [running_number, CommandState.RUNNING], "answer", 2)
        async with plant.device(running) as panel:
            assert await panel.read("input", WORDS["answer"]) == [running_number]
            assert await panel.write(0, running_number)
            assert await panel.ended(running_number) is CommandState.DONE
            done = struct.pack(">8H", *await panel.read("input", 110, 8))
            assert done.rstrip(b"\0") == b"polish"
        async with plant.device(running) as panel:
            assert await panel.ended(running_number) is CommandState.DONE, "remembered after its end too"
            assert await panel.write(0, running_number)
            await asyncio.sleep(1)
    works = [job.work for job in plant.left().told()]
    assert [work for work in works if work != "warm up"] == ["weld", "polish"]


async def test_command_while_another_runs_waits_for_its_turn(plant: ModbusPlant) -> None:
    plant.bridge("left")
    async with plant.server() as running, plant.device(running) as panel:
        await warmed_up(panel)
        first = await panel.ask_for_work("weld", 10)
        await panel.until(lambda words: words == [first, CommandState.RUNNING], "answer", 2)
        second = await panel.ask_for_work("paint", 0)
        assert await panel.word("answer") == first
        assert await panel.ended(second) is CommandState.DONE
    works = [job.work for job in plant.left().told()]
    assert [work for work in works if work != "warm up"] == ["weld", "paint"]


async def test_panel_sees_a_fault_and_confirms_who_takes_over(plant: ModbusPlant) -> None:
    plant.scenario("shift", f"  - {{task: one, robot: left, skill: work, arguments: {{work: {ENDLESS_WORK}}}}}\n")
    bridges = {robot: plant.bridge(robot) for robot in ("left", "middle", "right")}
    async with plant.server() as running, plant.device(running) as panel:
        await warmed_up(panel)
        await asyncio.sleep(1)  # the others are heard too
        number = await panel.command(SHIFT)
        await panel.until(lambda words: words == [number, CommandState.RUNNING], "answer", 2)
        async with asyncio.timeout(60):
            while ENDLESS_WORK not in [job.work for job in plant.left().told()]:
                await asyncio.sleep(0.05)
        assert await panel.read("input", WORDS["faults_1"], 2) == [0, 0]
        await asyncio.to_thread(bridges["left"].end, signal.SIGKILL)
        (decision,) = await panel.until(lambda words: words[0] != 0, "decision")
        assert await panel.read("input", WORDS["faults_1"], 2) == [0b001, 0]
        assert await panel.word("failed") == 1
        assert await panel.word("candidates") == 2
        candidates = await panel.read("input", WORDS["candidate_1"], 3)
        assert sorted(candidates[:2]) == [2, 3]
        assert candidates[2] == 0
        assert 0 < (await panel.read("input", WORDS["score_1"]))[0] <= 10_000
        # A number that stands for no decision is refused.
        assert await panel.write(3, candidates[0])
        assert await panel.write(2, 999)
        assert await panel.until(lambda words: words[0] == 999, "decided", 2) == [999, DecisionOutcome.REFUSED]
        assert await panel.write(2, decision)
        assert await panel.until(lambda words: words[0] == decision, "decided", 2) == [decision, DecisionOutcome.TAKEN]
        await panel.until(lambda words: words[0] == 0, "decision")
        chosen = ("left", "middle", "right")[candidates[0] - 1]
        async with asyncio.timeout(60):
            while [job.work for job in plant.machines[chosen].told()] != [ENDLESS_WORK]:
                await asyncio.sleep(0.05)
        assert await panel.read("input", WORDS["answer"], 2) == [number, CommandState.RUNNING]


async def test_who_may_not_write_may_read(plant: ModbusPlant) -> None:
    plant.bridge("left")
    async with plant.server() as running, plant.device(running, writers=["10.0.0.0/24"]) as panel:
        await panel.until(lambda words: words[0] == 1, "connected")
        assert not await panel.write(0, 1)
        assert not await panel.write(60, 1)
        assert await panel.word("answer") == 0
    async with plant.server() as running, plant.device(running) as panel:
        await panel.until(lambda words: words[0] == 1, "connected")
        assert not await panel.write(5, 1), "an address without a meaning"
        assert not await panel.write(5000, 1)


async def test_while_the_server_is_away_nothing_is_fresh_and_nothing_is_begun_later(plant: ModbusPlant) -> None:
    plant.bridge("left")
    async with plant.server() as running:
        url = running
        device = plant.device(running)
        panel = await device.__aenter__()
        await warmed_up(panel)
        number = await panel.ask_for_work("weld", 15)
        await panel.until(lambda words: words == [number, CommandState.RUNNING], "answer", 2)
    try:
        await panel.until(lambda words: words[0] == 0, "connected", timeout_s=60)
        assert await panel.read("discrete", 0) == [0]
        assert await panel.word("state") == CommandState.RUNNING, "it goes on, and is asked for later"
        async with plant.server() as again:
            assert again.url == url.url
            assert await panel.ended(number, 40) is CommandState.DONE
        await panel.until(lambda words: words[0] == 0, "connected", timeout_s=60)
        refused = await panel.ask_for_work("never", 0)
        assert await panel.ended(refused) is CommandState.REFUSED
        async with plant.server():
            await panel.until(lambda words: words[0] == 1, "connected", timeout_s=60)
            await asyncio.sleep(1)
    finally:
        await device.__aexit__(None, None, None)
    works = [job.work for job in plant.left().told()]
    assert [work for work in works if work != "warm up"] == ["weld"]
