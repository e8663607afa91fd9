"""Devices that are silent, slow, or answer rubbish: what each makes of its own values, and of nobody else's."""

from __future__ import annotations

import asyncio
import struct
from typing import Any

import pytest

from tests.contract.harness import NUMBER, message_of
from tests.integration.modbus.conftest import Behave, Device, Start, holding, of, silent_at, words
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

DATA: dict[str, Any] = {
    "two": {
        "id": 10,
        "fields": {"near": {"type": "UInt16"}, "far": {"type": "UInt16"}},
        "source": {
            "registers": {"near": {"table": "holding", "address": 5}, "far": {"table": "holding", "address": 500}}
        },
    }
}


async def test_one_request_without_an_answer_makes_its_own_value_bad(device: Device, start: Start) -> None:
    device.behave = silent_at(500)
    bench = await start({"plc": of(device)}, DATA)
    await until(lambda: bench.values(10) == (5, "BadTimeout"), "the time-out")
    assert bench.driver.status().connected
    assert bench.recorder.dropped(Drop.NO_ANSWER) >= 1
    device.behave = words
    await until(lambda: bench.values(10) == (5, 500), "the recovery")
    assert bench.recorder.lost(Topic(300, 2, 10)) == 0


async def test_device_that_answers_nothing_is_lost_and_asked_less_often(device: Device, start: Start) -> None:
    bench = await start({"plc": of(device, retry_s=[0.05, 0.4])}, DATA)
    await until(lambda: bench.values(10) == (5, 500), "the values")
    device.behave = silent_at(5, 500)
    await until(lambda: bench.recorder.lost(Topic(300, 2, 10)) == 1, "the loss")
    assert not bench.driver.status().connected
    assert "look at its power, cable, address and unit" in bench.driver.status().detail
    await asyncio.sleep(1.0)
    before = len(device.requests)
    await asyncio.sleep(1.2)
    assert len(device.requests) - before <= 4, "with 0.4 s between and 0.15 s of waiting"
    device.behave = words
    await until(lambda: len(bench.recorder.found(Topic(300, 2, 10))) == 2, "the return")
    await until(lambda: bench.values(10) == (5, 500), "the values")
    assert bench.recorder.lost(Topic(300, 2, 10)) == 1


async def test_exception_makes_its_own_value_bad_with_the_reason(device: Device, start: Start) -> None:
    codes = {
        4: "BadDeviceFailure",
        6: "BadResourceUnavailable",
        2: "BadConfigurationError",
        8: "BadSensorFailure",
        10: "BadNoCommunication",
    }
    code = 4

    def refuse(pdu: bytes, address: int, count: int) -> bytes:
        return bytes([pdu[0] | 0x80, code]) if address == 500 else words(pdu, address, count)

    device.behave = refuse
    bench = await start({"plc": of(device)}, DATA)
    for code, status in codes.items():  # noqa: B007 - the device uses it
        await until(lambda: bench.values(10) == (5, status), status)  # noqa: B023 - awaited in its turn
    assert bench.recorder.dropped(Drop.REJECTED) >= len(codes)
    assert bench.driver.status().connected


RUBBISH: dict[str, tuple[Behave, Drop]] = {
    "too many": (lambda pdu, address, count: bytes([3, 2 * count + 2]) + bytes(2 * count + 2), Drop.MALFORMED),
    "none": (lambda pdu, address, count: bytes([3, 0]), Drop.MALFORMED),
    "other function": (lambda pdu, address, count: bytes([4, 2]) + bytes(2), Drop.MALFORMED),
    "half": (lambda pdu, address, count: bytes([3, 200, 1]), Drop.NO_ANSWER),
    "unknown function": (lambda pdu, address, count: bytes([99, 1, 2, 3]), Drop.NO_ANSWER),
    "other unknown function": (lambda pdu, address, count: bytes([99, 1, 2, 3]), Drop.MALFORMED),
    "cut": (lambda pdu, address, count: b"\x03", Drop.NO_ANSWER),
}


@pytest.mark.parametrize("what", RUBBISH)
async def test_rubbish_is_no_value(device: Device, start: Start, what: str) -> None:
    device.behave, cause = RUBBISH[what]
    data = {"one": {"id": 10, "type": "UInt16", "source": {"at": {"table": "holding", "address": 5}}}}
    bench = await start({"plc": of(device)}, data)
    await until(lambda: bench.recorder.dropped(cause) >= 2, "the drops")
    assert all(value == "BadCommunicationError" for values in bench.all_values(10) for value in values)
    device.behave = words
    await until(lambda: bench.values(10) == (5,), "the value")


async def test_late_answer_is_not_taken_for_the_next_one(device: Device, start: Start) -> None:
    held: list[bytes] = []

    def late(answer: bytes) -> list[bytes]:
        held.append(answer)
        return [held.pop(0)] if len(held) > 1 else []

    device.raw = late
    bench = await start({"plc": of(device)}, DATA)
    await asyncio.sleep(1.5)
    assert all(set(values) <= {5, 500, "BadTimeout"} for values in bench.all_values(10))
    assert all(values[0] != 500 and values[1] != 5 for values in bench.all_values(10))
    device.raw = lambda answer: [answer]
    await until(lambda: bench.values(10) == (5, 500), "the values")


async def test_answer_in_pieces_is_one_answer(device: Device, start: Start) -> None:
    device.raw = lambda answer: [answer[:3], answer[3:8], answer[8:]]
    bench = await start({"plc": of(device)}, DATA)
    await until(lambda: bench.values(10) == (5, 500), "the values")
    assert bench.recorder.dropped(Drop.NO_ANSWER) == 0


async def test_slow_device_holds_up_no_other(device: Device, start: Start) -> None:
    quick = Device()
    await quick.listen()
    try:
        device.behave = lambda pdu, address, count: None
        data = {"slow": holding("slow", 10), "quick": holding("quick", 11, 2)}
        number = 0

        def count_up(pdu: bytes, address: int, count: int) -> bytes:
            nonlocal number
            number += 1
            return struct.pack(">BBH", pdu[0], 2, number & 0xFFFF)

        quick.behave = count_up
        await start({"slow": of(device, timeout_s=5.0), "quick": of(quick)}, data)
        before = number
        await asyncio.sleep(1.0)
        assert number - before > 20, "it is asked each 0.02 s"
    finally:
        await quick.hang_up()


async def test_mistake_of_ours_is_said_and_leaves_no_value_good(
    device: Device, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = await start({"plc": of(device)}, DATA)
    await until(lambda: bench.values(10) == (5, 500), "the values")

    async def broken(_: object) -> None:
        raise RuntimeError("a mistake")

    monkeypatch.setattr("ua_bridges.modbus.device.Device._turn", broken)
    await until(lambda: bench.recorder.lost(Topic(300, 2, 10)) == 1, "the loss")
    status = bench.driver.status()
    assert not status.connected
    assert "a mistake of the bridge (RuntimeError('a mistake'))" in status.detail


async def test_mistake_of_ours_in_a_callback_is_logged_and_not_the_devices(
    device: Device, start: Start, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def broken(_: object, write: object) -> None:
        raise KeyError(f"a mistake with {type(write).__name__}")

    monkeypatch.setattr("ua_bridges.modbus.device.Device.take", broken)
    bench = await start({"plc": of(device)}, write_data())
    assert bench.driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, 7))
    await until(lambda: caplog.records, "the log")
    [record] = caplog.records
    assert record.exc_info is not None
    assert repr(record.exc_info[1]) == "KeyError('a mistake with SinkWrite')"
    assert bench.recorder.dropped(Drop.MALFORMED) == 0


def write_data(**more: Any) -> dict[str, Any]:
    sink = {"at": {"table": "holding", "address": 7}, **more}
    return {**DATA, "wanted": {"id": 11, "type": "UInt16", "origin": "server", "sink": sink}}


WANTED = Topic(0, 2, 11)


async def test_write_that_the_device_does_not_keep_is_told(device: Device, start: Start) -> None:
    def forgetful(pdu: bytes, address: int, count: int) -> bytes:
        return pdu if pdu[0] == 6 else words(pdu, address, count)

    device.behave = forgetful
    bench = await start({"plc": of(device)}, write_data(read_back=True))
    await until(lambda: bench.values(10), "the values")
    assert bench.driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, 99))
    await until(lambda: bench.recorder.dropped(Drop.REJECTED) == 1, "the drop")
    assert bench.driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, 7))
    await until(lambda: (6, 7, 7) in device.requests, "the second write")
    await asyncio.sleep(0.1)
    assert bench.recorder.dropped(Drop.REJECTED) == 1


@pytest.mark.parametrize("rewrite", [True, False])
async def test_last_value_is_written_again_only_where_that_is_wanted(
    device: Device, start: Start, rewrite: bool
) -> None:
    def taking(pdu: bytes, address: int, count: int) -> bytes:
        return pdu if pdu[0] == 6 else words(pdu, address, count)

    device.behave = taking
    bench = await start({"plc": of(device)}, write_data(rewrite=rewrite))
    assert bench.driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, 99))
    await until(lambda: (6, 7, 99) in device.requests, "the write")
    await device.hang_up()
    await until(lambda: not bench.driver.status().connected, "the loss")
    told = bench.driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, 100))
    assert told is rewrite
    device.requests.clear()
    await device.listen()
    await until(lambda: bench.driver.status().connected, "the return")
    await asyncio.sleep(0.2)
    assert [request for request in device.requests if request[0] == 6] == ([(6, 7, 100)] if rewrite else [])


async def test_deadband_keeps_a_write_back(device: Device, start: Start) -> None:
    def taking(pdu: bytes, address: int, count: int) -> bytes:
        return pdu if pdu[0] == 6 else words(pdu, address, count)

    device.behave = taking
    data = write_data()
    data["wanted"]["sink"]["at"]["deadband"] = 5
    bench = await start({"plc": of(device)}, data)
    for value in (100, 104, 96, 106, 103):
        assert bench.driver.publish(WANTED, NUMBER.metadata(WANTED.name), message_of(WANTED, value))
    await until(lambda: (6, 7, 106) in device.requests, "the last write")
    await asyncio.sleep(0.1)
    assert [count for function, _, count in device.requests if function == 6] == [100, 106]
