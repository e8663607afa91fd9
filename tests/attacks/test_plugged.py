"""Programs on the D-Bus and devices on serial lines that misbehave; an honest neighbour is read all the time."""

# pyright: reportPrivateUsage=false, reportUnknownMemberType=false

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from dbus_fast import Message, MessageType, NameFlag, Variant

from tests.attacks.fake_bus import FakeBus
from tests.integration.plugged.conftest import ROVER, Bridge, BusDaemon, bus, started
from tests.integration.plugged.test_dbus import Program, program
from tests.plugged_device import PtyDevice
from tests.waiting import until
from ua_fleet.counters import Drop
from ua_fleet.values import BuiltinType, StatusCode
from ua_fleet.values import Variant as Value

__all__ = ["bus"]

OLDEST_S = 5.0
HONEST, ATTACKED = 10, 11
ON_BUS = (
    ROVER
    + """\
      tap: {id: 11, type: String, source: {signal: trbots.tap}}
    skills:
      ask:
        id: 21
        arguments: {a: {type: Int32}}
        results: {said: {type: String}}
        timeout_s: 1
        via: {call: {name: trbots.tap, path: /trbots/tap, member: Ask}}
"""
)
NO_TEXT = Value(BuiltinType.STATUS_CODE, StatusCode.BAD_TYPE_MISMATCH)
"""The value of what is of another type than `fleet.yaml` says."""
NOT_TEXT = b"\xff\xfe\xfd\xfc"


def raw(message: Message, serial: int) -> bytes:
    """The bytes of a message whose text `abcd` is no UTF-8."""
    message.serial = serial
    return bytes(message._marshall(False)).replace(b"abcd", NOT_TEXT)


def sock(program: Program) -> Any:
    """The socket under a connection, for what the library would not send."""
    return program.bus._sock


def signal(signature: str, *values: Any) -> Message:
    return Message(
        message_type=MessageType.SIGNAL,
        path="/",
        interface="trbots.tap",
        member="Value",
        signature=signature,
        body=list(values),
    )


def deep(levels: int) -> Variant:
    value = Variant("i", 1)
    for _ in range(levels):
        value = Variant("v", value)
    return value


Attack = Callable[[Program], Awaitable[None]]


async def no_text(tap: Program) -> None:
    sock(tap).send(raw(signal("s", "abcd"), 1000))


async def no_text_as_the_name_of_a_member(tap: Program) -> None:
    message = signal("s", "x")
    message.member = "abcd"
    sock(tap).send(raw(message, 1000))


async def deep_variants(tap: Program) -> None:
    for levels in (10, 60):
        await tap.bus.send(signal("v", deep(levels)))


async def other_types(tap: Program) -> None:
    for signature, value in (
        ("d", 1.0),
        ("ai", [1] * 1000),
        ("(ii)", [1, 2]),
        ("a{sv}", {"x": Variant("i", 1)}),
        ("", None),
    ):
        await tap.bus.send(signal(signature, *([] if value is None else [value])))


async def large(tap: Program) -> None:
    for _ in range(5):
        await tap.bus.send(signal("s", "x" * (4 << 20)))
        await tap.catch_up()


async def rubbish(tap: Program) -> None:
    with contextlib.suppress(OSError):
        for _ in range(20):
            sock(tap).send(b"l\x04\x01\x01" + b"\xff" * 4096)
            await asyncio.sleep(0.01)


async def coming_and_going(tap: Program) -> None:
    for _ in range(200):
        await tap.bus.release_name("trbots.tap")
        await tap.bus.request_name("trbots.tap", NameFlag.DO_NOT_QUEUE)


ATTACKS = (no_text, no_text_as_the_name_of_a_member, deep_variants, other_types, large, rubbish, coming_and_going)


async def beat(gas: Program) -> None:
    number = 0.0
    while True:
        number += 1.0
        await gas.emit("trbots.gas", "d", number)
        await asyncio.sleep(0.05)


async def longest_pause_s(bridge: Bridge, seconds: float) -> float:
    """How long the honest neighbour was not read at most, within that time and until it is read once more."""
    begun = last = time.monotonic()
    longest_s, seen = 0.0, len(bridge.values(HONEST))
    while True:
        await asyncio.sleep(0.05)
        longest_s = max(longest_s, time.monotonic() - last)
        if (now := len(bridge.values(HONEST))) > seen:
            seen, last = now, time.monotonic()
            if last > begun + seconds:
                return longest_s
        if longest_s > OLDEST_S or bridge.driver.status().is_over:
            return float("inf")


@pytest.mark.needs("dbus")
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda each: each.__name__)
async def test_a_program_that_misbehaves_costs_itself(bus: BusDaemon, attack: Attack) -> None:
    async with (
        started(ON_BUS.replace("ADDRESS", bus.address)) as bridge,
        program(bus, "trbots.gas") as gas,
        program(bus, "trbots.tap") as tap,
    ):
        await bridge.found(HONEST)
        await bridge.found(ATTACKED)
        bridge.want(HONEST, ATTACKED)
        beating = asyncio.ensure_future(beat(gas))
        await until(lambda: bridge.values(HONEST), "the value")
        with contextlib.suppress(OSError, EOFError):
            await asyncio.wait_for(attack(tap), 10)
        assert await longest_pause_s(bridge, 1.5) < OLDEST_S
        assert all(isinstance(value, str) or value == NO_TEXT for value in bridge.values(ATTACKED))
        beating.cancel()
        await asyncio.wait([beating])


@pytest.mark.needs("dbus")
async def test_a_method_whose_answer_is_no_text_fails_alone(bus: BusDaemon) -> None:
    async with (
        started(ON_BUS.replace("ADDRESS", bus.address)) as bridge,
        program(bus, "trbots.gas") as gas,
        program(bus, "trbots.tap") as tap,
    ):

        def answer(message: Message) -> bool:
            if message.member == "Ask":
                sock(tap).send(raw(Message.new_method_return(message, "s", ["abcd"]), 1000))
                return True
            return False

        tap.bus.add_message_handler(answer)
        await bridge.found(HONEST)
        bridge.want(HONEST)
        beating = asyncio.ensure_future(beat(gas))
        await until(lambda: bridge.values(HONEST), "the value")
        ended = await bridge.end(bridge.begin(21, 1))
        assert ended.message
        assert await longest_pause_s(bridge, 1.0) < OLDEST_S
        beating.cancel()
        await asyncio.wait([beating])


ON_BOTH = """
version: 1
pubsub: {security: none}
bridges: {pc: {kind: plugged, space: 300, status_id: 1, bus: "BUS", devices: {good: {path: GOOD}}}}
robots:
  rover_pc:
    bridge: pc
    data:
      level: {id: 10, type: Double, source: {device: good, line: "{value}"}}
      tap: {id: 11, type: String, source: {signal: trbots.tap, when: always}}
"""


async def test_a_bus_that_forwards_what_is_no_text_is_put_aside(tmp_path: Path) -> None:
    ended = threading.Event()

    def beat() -> None:
        while not ended.wait(0.05):
            good.say(f"{time.monotonic()}\n")

    with FakeBus(tmp_path / "bus") as fake, PtyDevice(tmp_path / "good", deaf) as good:
        async with started(ON_BOTH.replace("BUS", fake.address).replace("GOOD", str(tmp_path / "good"))) as bridge:
            await bridge.found(HONEST)
            bridge.want(HONEST)
            await asyncio.to_thread(good.wait_for_reader)
            beating = threading.Thread(target=beat, daemon=True)
            beating.start()
            try:
                await until(lambda: fake.met > 1, "that it is tried again")
                assert await longest_pause_s(bridge, 1.0) < OLDEST_S
                assert "no message of D-Bus (UnicodeDecodeError)" in bridge.driver.status().aside["D-Bus"]
                assert bridge.recorder.dropped(Drop.MISBEHAVED)
                assert bridge.recorder.lost(bridge.topic(ATTACKED))
                assert set(bridge.values(ATTACKED)) <= {"fine"}
            finally:
                ended.set()
                await asyncio.to_thread(beating.join, 5)


ON_LINES = """
version: 1
pubsub: {security: none}
bridges: {pc: {kind: plugged, space: 300, status_id: 1, devices: {good: {path: GOOD}, bad: {path: BAD}}}}
robots:
  rover_pc:
    bridge: pc
    data:
      level: {id: 10, type: Double, source: {device: good, line: "{value}"}}
      tag:
        id: 11
        fields: {name: {type: String}, level: {type: Double}, count: {type: Int32}}
        source: {device: bad, line: "TAG {name} {level} {count}"}
"""
LINES: dict[str, bytes] = {
    "no_text": b"TAG \xff\xfe\xc3 1.0 1\n" * 50,
    "half_a_character": b"TAG \xc3\n \xe2\x82 1.0 1\n\xf0\x9f" * 50,
    "zeros": b"\0" * 20_000 + b"TAG \0 \0 \0\n" * 50,
    "orders_for_a_terminal": b"TAG \x1b[2J\x1b]0;x\x07 1.0 1\n" * 50,
    "numbers_that_are_none": b"".join(
        b"TAG x %s %s\n" % pair
        for pair in ((b"1e999", b"1"), (b"nan", b"1"), (b"1", b"9" * 3000), (b"9" * 3000, b"1"), (b"0x1p9", b"-0"))
    ),
    "a_line_without_end": b"TAG " + b"x" * 200_000,
    "nothing_but_separators": b"TAG" + b" " * 4000 + b"\n" + b"TAG" + b" x" * 2000 + b"\n",
    "nothing_but_ends_of_lines": b"\n" * 100_000,
    "the_same_line_without_end": b"TAG x 1.0 1\n" * 20_000,
}


def is_text(value: str) -> bool:
    """Whether it can be written as UTF-8: bytes that are none are surrogates where they are let through."""
    return not any("\ud800" <= character <= "\udfff" for character in value)


def deaf(_device: PtyDevice, _line: str) -> None:
    """A device that does nothing that it is told."""


@pytest.mark.parametrize("kind", LINES)
async def test_a_device_on_a_line_that_misbehaves_costs_itself(tmp_path: Path, kind: str) -> None:
    text = ON_LINES.replace("GOOD", str(tmp_path / "good")).replace("BAD", str(tmp_path / "bad"))
    ended = threading.Event()

    def beat() -> None:
        while not ended.wait(0.05):
            good.say(f"{time.monotonic()}\n")

    def misbehave() -> None:
        for at in range(0, len(LINES[kind]), 1000):
            if ended.is_set():
                return
            bad.write(LINES[kind][at : at + 1000])
            time.sleep(0.002)

    with PtyDevice(tmp_path / "good", deaf) as good, PtyDevice(tmp_path / "bad", deaf) as bad:
        async with started(text) as bridge:
            await bridge.found(HONEST)
            await bridge.found(ATTACKED)
            bridge.want(HONEST, ATTACKED)
            await asyncio.to_thread(good.wait_for_reader)
            await asyncio.to_thread(bad.wait_for_reader)
            threads = [threading.Thread(target=each, daemon=True) for each in (beat, misbehave)]
            for thread in threads:
                thread.start()
            try:
                await until(lambda: bridge.values(HONEST), "the value")
                assert await longest_pause_s(bridge, 2.0) < OLDEST_S
                read = [value for sample in bridge.recorder.samples(bridge.topic(ATTACKED)) for value in sample.values]
                assert all(is_text(str(value)) for value in read), "what is not text never becomes one"
            finally:
                ended.set()
                for thread in threads:
                    await asyncio.to_thread(thread.join, 5)


async def test_a_device_that_comes_and_goes_costs_itself(tmp_path: Path) -> None:
    text = ON_LINES.replace("GOOD", str(tmp_path / "good")).replace("BAD", str(tmp_path / "bad"))
    ended = threading.Event()

    def beat() -> None:
        while not ended.wait(0.05):
            good.say(f"{time.monotonic()}\n")

    def come_and_go() -> None:
        while not ended.is_set():
            with PtyDevice(tmp_path / "bad", deaf) as bad:
                bad.write(b"TAG x")
                ended.wait(0.03)

    with PtyDevice(tmp_path / "good", deaf) as good:
        async with started(text) as bridge:
            await bridge.found(HONEST)
            bridge.want(HONEST, ATTACKED)
            await asyncio.to_thread(good.wait_for_reader)
            threads = [threading.Thread(target=each, daemon=True) for each in (beat, come_and_go)]
            for thread in threads:
                thread.start()
            try:
                await until(lambda: bridge.values(HONEST), "the value")
                assert await longest_pause_s(bridge, 3.0) < OLDEST_S
            finally:
                ended.set()
                for thread in threads:
                    await asyncio.to_thread(thread.join, 5)
