"""What goes on while a part of it does not: silent requests, refusals that pass, and a stream of writes."""

from __future__ import annotations

import asyncio
import secrets
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from ua_bridges.modbus.driver import ModbusDriver, create_driver

from tests.contract.harness import NUMBER, Recorder, message_of
from tests.integration.modbus.conftest import Behave, Bench, Device, Start, of, silent_at, words
from tests.waiting import until
from ua_fleet.bridge.driver import Execution, ExecutionEnded, ExecutionForgotten
from ua_fleet.config.load import load_content
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

WANTED = Topic(0, 2, 11)


def word(id: int, address: int, **more: Any) -> dict[str, Any]:
    return {"id": id, "type": "UInt16", "source": {"at": {"table": "holding", "address": address}, **more}}


SINK: dict[str, Any] = {
    "id": 11,
    "type": "UInt16",
    "origin": "server",
    "sink": {"at": {"table": "holding", "address": 7}},
}


def publish(driver: ModbusDriver, value: int) -> None:
    assert driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, value))


def losses(bench: Bench, *ids: int) -> int:
    return sum(bench.recorder.lost(Topic(300, 2, each)) for each in ids)


@pytest.mark.parametrize(("silent", "shown"), [(500, [(5,), ("BadTimeout",)]), (5, [("BadTimeout",), (500,)])])
async def test_group_of_which_nothing_is_answered_takes_no_other_with_it(
    device: Device, start: Start, silent: int, shown: list[tuple[Any, ...]]
) -> None:
    data = {"fast": word(10, 5), "slow": word(12, 500, poll="slow")}
    bench = await start({"plc": of(device)}, data, polls={"slow": {"period_s": 0.1}})
    await until(lambda: [bench.values(10), bench.values(12)] == [(5,), (500,)], "the values")
    device.behave = silent_at(silent)
    await until(lambda: [bench.values(10), bench.values(12)] == shown, "the time-out")
    await asyncio.sleep(0.5)
    assert bench.driver.status().connected
    device.behave = words
    await until(lambda: [bench.values(10), bench.values(12)] == [(5,), (500,)], "the recovery")
    assert losses(bench, 10, 12) == 0


async def test_device_whose_first_requests_are_silent_is_found_by_another(device: Device, start: Start) -> None:
    device.behave = silent_at(5, 6)
    data = {"a": word(10, 5), "b": word(12, 6, poll="slow"), "c": word(13, 500)}
    bench = await start({"plc": of(device)}, data, polls={"slow": {"period_s": 1.0}})
    await until(lambda: bench.values(13) == (500,), "the value")
    await until(lambda: [bench.values(10), bench.values(12)] == [("BadTimeout",)] * 2, "the time-outs")
    assert losses(bench, 10, 12, 13) == 0


async def test_write_without_an_answer_leaves_the_values_as_they_are(device: Device, start: Start) -> None:
    device.behave = lambda pdu, address, count: None if pdu[0] == 6 else words(pdu, address, count)
    bench = await start({"plc": of(device)}, {"a": word(10, 5), "wanted": SINK})
    await until(lambda: bench.values(10) == (5,), "the value")
    for value in range(3):
        publish(bench.driver, value)
    await until(lambda: bench.recorder.dropped(Drop.NO_ANSWER) == 3, "the drops")
    assert losses(bench, 10) == 0
    assert bench.all_values(10) == [(5,)]


async def test_device_that_falls_silent_is_away_after_two_requests(device: Device, start: Start) -> None:
    data = {f"x{n}": word(20 + n, 100 * n) for n in range(1, 9)}
    bench = await start({"plc": of(device)}, data)
    await until(lambda: bench.values(28) == (800,), "the values")
    device.behave = lambda pdu, address, count: None
    await until(lambda: not bench.driver.status().connected, "the loss")
    assert bench.recorder.dropped(Drop.NO_ANSWER) == 2


WRONG_ANSWERS: dict[str, Behave] = {
    "function": lambda pdu, address, count: bytes([3, 2, 0, 0]),
    "address": lambda pdu, address, count: struct.pack(">BHH", 6, address + 1, count),
}


@pytest.mark.parametrize("what", WRONG_ANSWERS)
async def test_answer_to_another_write_is_no_success(device: Device, start: Start, what: str) -> None:
    wrong = WRONG_ANSWERS[what]
    device.behave = lambda pdu, address, count: (wrong if pdu[0] == 6 else words)(pdu, address, count)
    bench = await start({"plc": of(device)}, {"a": word(10, 5), "wanted": SINK})
    await until(lambda: bench.values(10) == (5,), "the value")
    publish(bench.driver, 99)
    await until(lambda: bench.recorder.dropped(Drop.MALFORMED) == 1, "the drop")


async def test_values_are_read_together_again_once_the_device_is_back(device: Device, start: Start) -> None:
    device.behave = lambda pdu, address, count: words(pdu, address, count) if count == 1 else bytes([0x83, 2])
    registers = {f"f{n}": {"table": "holding", "address": n} for n in range(4)}
    fields = {name: {"type": "UInt16"} for name in registers}
    bench = await start({"plc": of(device)}, {"many": {"id": 10, "fields": fields, "source": {"registers": registers}}})
    await until(lambda: bench.values(10) == (0, 1, 2, 3), "the values, one by one")
    device.behave = words
    await device.hang_up()
    await until(lambda: not bench.driver.status().connected, "the loss")
    await device.listen()
    await until(lambda: "4 values in 1 requests, 3 saved" in bench.driver.status().detail, "the return")


async def test_stream_of_writes_leaves_time_for_all_readings(device: Device, start: Start) -> None:
    number = 0

    def count_up(pdu: bytes, address: int, count: int) -> bytes:
        nonlocal number
        number += 1
        return pdu if pdu[0] == 6 else struct.pack(">BBH", pdu[0], 2, number & 0xFFFF)

    device.behave = count_up
    data = {"fast": word(10, 5), "slow": word(12, 500, poll="slow"), "wanted": SINK}
    bench = await start({"plc": of(device)}, data, polls={"slow": {"period_s": 0.1}})
    await until(lambda: bench.values(10) and bench.values(12), "the values")
    before = [len(bench.all_values(each)) for each in (10, 12)]
    streaming = asyncio.ensure_future(stream(bench.driver, 120.0))
    await until(
        lambda: all(len(bench.all_values(each)) - count >= 3 for each, count in zip((10, 12), before, strict=True)),
        "values in the stream of writes",
    )
    await until(lambda: bench.recorder.dropped(Drop.RATE_LIMITED) > 0, "more than the device takes")
    assert not streaming.done()
    streaming.cancel()


async def stream(driver: ModbusDriver, duration_s: float) -> None:
    """More writes than the device takes."""
    until_s = time.monotonic() + duration_s
    value = 0
    while time.monotonic() < until_s:
        value += 1
        publish(driver, value & 0xFFFF)
        await asyncio.sleep(0.001)


class Program:
    """A PLC that begins what it is asked for, and ends it when the test says so."""

    def __init__(self, device: Device) -> None:
        self.words = {100: 5, 101: 5, 102: 0}
        self.answers: list[Callable[[], bytes | None]] = []
        """In place of the answers to the next requests that read."""
        self.refused: set[int] = set()
        """Addresses of requests for which it is too busy."""
        device.behave = self._answer

    def _answer(self, pdu: bytes, address: int, count: int) -> bytes | None:
        if pdu[0] == 6:
            self.words[address] = count
            if address == 100:
                self.words.update({101: count, 102: 1})
            return pdu
        if self.answers:
            return self.answers.pop(0)()
        if address in self.refused:
            return bytes([pdu[0] | 0x80, 6])
        content = [self.words.get(each, 0) for each in range(address, address + count)]
        return struct.pack(f">BB{count}H", pdu[0], 2 * count, *content)


class Plc:
    """A driver with one skill, and its device."""

    def __init__(self, driver: ModbusDriver, recorder: Recorder, program: Program) -> None:
        self.driver, self.recorder, self.program = driver, recorder, program

    def begin(self) -> bytes:
        (skill,) = self.driver.skills()
        execution = Execution(secrets.token_bytes(16), skill.topic, skill.targets[0].id, (), 20.0)
        self.driver.execute(execution)
        return execution.execution_id

    def ends(self) -> list[ExecutionEnded | ExecutionForgotten]:
        return [e for e in list(self.recorder.events) if isinstance(e, ExecutionEnded | ExecutionForgotten)]


@pytest.fixture
async def plc(device: Device, tmp_path: Path) -> AsyncIterator[Callable[[float], Awaitable[Plc]]]:
    drivers: list[ModbusDriver] = []

    async def begin(timeout_s: float) -> Plc:
        flags = {
            name: {"table": "holding", "address": 102, "bit": bit} for bit, name in enumerate(("busy", "done", "error"))
        }
        via = {
            "request": {"table": "holding", "address": 100},
            "accepted": {"table": "holding", "address": 101},
            **flags,
            "halt": {"table": "holding", "address": 103},
            "results": {"way": {"table": "holding", "address": 110}},
            "poll_s": 0.02,
        }
        skill = {"id": 20, "timeout_s": timeout_s, "results": {"way": {"type": "UInt16"}}, "via": via}
        fleet = {
            "version": 1,
            "pubsub": {"security": "none"},
            "bridges": {"plc": {"kind": "modbus", "space": 300, "status_id": 1, "devices": {"plc": of(device)}}},
            "robots": {
                "machine": {"bridge": "plc", "skill_status_id": 2, "data": {"wanted": SINK}, "skills": {"work": skill}}
            },
        }
        program, recorder = Program(device), Recorder()
        driver = create_driver(load_content(yaml.safe_dump(fleet, sort_keys=False).encode(), "F", {}), "plc")
        driver.remember_in(tmp_path)
        await driver.start(recorder)
        drivers.append(driver)
        return Plc(driver, recorder, program)

    yield begin
    for driver in drivers:
        await driver.stop()


DISTURBED: dict[str, tuple[Callable[[], bytes | None], Drop]] = {
    "needs longer": (lambda: bytes([0x83, 5]), Drop.REJECTED),
    "busy": (lambda: bytes([0x83, 6]), Drop.REJECTED),
    "no such address": (lambda: bytes([0x83, 2]), Drop.REJECTED),
    "short": (lambda: bytes([3, 2, 0, 0]), Drop.MALFORMED),
}


@pytest.mark.parametrize("how", DISTURBED)
async def test_answer_that_tells_nothing_leaves_a_skill_to_its_device(
    plc: Callable[[float], Awaitable[Plc]], how: str
) -> None:
    made = await plc(20.0)
    execution_id = made.begin()
    await until(lambda: made.program.words[102] == 1, "the work")
    answer, cause = DISTURBED[how]
    made.program.answers = [answer] * 3
    await until(lambda: made.recorder.dropped(cause) == 3, "the drops")
    assert made.ends() == []
    made.program.words.update({102: 2, 110: 42})
    await until(made.ends, "the end")
    assert made.ends() == [ExecutionEnded(execution_id, 0, (42,))]


async def test_device_that_tells_nothing_more_ends_a_skill_at_its_time(
    plc: Callable[[float], Awaitable[Plc]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ua_bridges.modbus.job._HALTED_S", 0.2)
    made = await plc(0.5)
    made.begin()
    await until(lambda: made.program.words[102] == 1, "the work")
    made.program.refused = {100}
    await until(made.ends, "the end")
    (ended,) = made.ends()
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == StatusCode.BAD_TIMEOUT
    assert ended.message == "it takes longer than 0.5 s; the device is busy: holding 100 to 102 (exception 6)"


async def test_skill_that_took_too_long_and_was_halted_says_so(plc: Callable[[float], Awaitable[Plc]]) -> None:
    made = await plc(0.5)
    made.begin()
    await until(lambda: made.program.words[102] == 1, "the work")
    await until(lambda: made.program.words.get(103, 0) != 0, "the halt")
    made.program.words[102] = 4
    await until(made.ends, "the end")
    (ended,) = made.ends()
    assert isinstance(ended, ExecutionEnded)
    assert (ended.status, ended.message) == (StatusCode.BAD_TIMEOUT, "it took longer than 0.5 s; it was told to stop")


async def test_skill_whose_results_stay_out_is_uncertain_at_its_time(
    plc: Callable[[float], Awaitable[Plc]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ua_bridges.modbus.job._HALTED_S", 0.2)
    made = await plc(0.5)
    made.begin()
    await until(lambda: made.program.words[102] == 1, "the work")
    made.program.refused = {110}
    made.program.words[102] = 2
    await until(made.ends, "the end")
    (ended,) = made.ends()
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == StatusCode.UNCERTAIN
    assert ended.message == "it is done; the device is busy: holding 110 (exception 6)"


async def test_skill_in_a_stream_of_writes_is_done(plc: Callable[[float], Awaitable[Plc]]) -> None:
    made = await plc(3.0)
    streaming = asyncio.ensure_future(stream(made.driver, 3.0))
    await asyncio.sleep(0.3)
    execution_id = made.begin()
    await until(lambda: made.program.words[102] == 1, "the work")
    made.program.words.update({102: 2, 110: 42})
    await until(made.ends, "the end")
    assert made.ends() == [ExecutionEnded(execution_id, 0, (42,))]
    assert not streaming.done()
    streaming.cancel()


async def test_skill_that_comes_too_late_is_not_given_to_the_device(plc: Callable[[float], Awaitable[Plc]]) -> None:
    made = await plc(0.1)
    made.program.answers = [lambda: None]
    made.begin()
    await until(made.ends, "the end")
    (ended,) = made.ends()
    assert isinstance(ended, ExecutionEnded)
    assert (ended.status, ended.message) == (
        StatusCode.BAD_NO_COMMUNICATION,
        "the device could not be given it within 0.1 s",
    )
    await asyncio.sleep(0.3)
    assert made.program.words[100] == 5, "nothing was asked of it"
