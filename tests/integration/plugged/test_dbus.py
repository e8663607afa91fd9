"""Signals and methods on a real D-Bus."""

# pyright: reportPrivateUsage=false, reportUnknownMemberType=false

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncGenerator
from typing import Any

import pytest
from dbus_fast import BusType, DBusError, ErrorType, Message, MessageType
from dbus_fast.aio import MessageBus
from ua_bridges.plugged import bus as bus_module
from ua_bridges.plugged.bus import Signal

from tests.contract.harness import NUMBER, Recorder, message_of
from tests.integration.plugged.conftest import ROVER, BusDaemon, started
from tests.waiting import until
from ua_fleet.bridge import Offenders
from ua_fleet.bridge.driver import ExecutionEnded
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotOffline
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode

pytestmark = pytest.mark.needs("dbus")

FLEET = (
    ROVER
    + """\
      where: {id: 11, fields: {x: {type: Double}, y: {type: Int16}}, source: {signal: trbots.where, sender: trbots.gas}}
      lamp: {id: 12, type: Double, origin: server, sink: {call: {name: trbots.lamp, member: Dim}}}
    skills:
      read_gas: {id: 20, immediate: true, results: {value: {type: Double}}, via: {read: gas}, timeout_s: 1}
      add:
        id: 21
        arguments: {a: {type: Int32}, b: {type: Int32}}
        results: {sum: {type: Int32}}
        timeout_s: 1
        via: {call: {name: trbots.lamp, path: /trbots/lamp, member: Add}}
"""
)
LAMP = Topic(0, 2, 12)


class Program:
    """A program on the bus: a sensor that publishes, and an actuator that obeys."""

    def __init__(self, bus: MessageBus) -> None:
        self.bus = bus
        self.rules: list[str] = []
        self.dimmed: list[float] = []
        bus.add_message_handler(self._obey)

    def _obey(self, message: Message) -> Message | None:
        if message.message_type is not MessageType.METHOD_CALL:
            return None
        if message.member == "Dim":
            self.dimmed.append(message.body[0])
            return Message.new_method_return(message)
        if message.member == "Add":
            a, b = message.body
            if a == 0:
                raise DBusError(ErrorType.FAILED, "nothing to add")
            return None if a < 0 else Message.new_method_return(message, "i", [a + b])
        return None

    async def emit(self, interface: str, signature: str, *values: Any) -> None:
        await self.bus.send(
            Message(
                message_type=MessageType.SIGNAL,
                path="/",
                interface=interface,
                member="Value",
                signature=signature,
                body=list(values),
            )
        )

    async def catch_up(self) -> None:
        """Wait for the bus: dbus-fast takes a full socket for a broken one."""
        name = "org.freedesktop.DBus"
        await self.bus.call(Message(destination=name, path="/org/freedesktop/DBus", interface=name, member="GetId"))


@contextlib.asynccontextmanager
async def program(bus: BusDaemon, *names: str) -> AsyncGenerator[Program]:
    connection = await MessageBus(bus_address=bus.address, bus_type=BusType.SESSION).connect()
    try:
        made = Program(connection)
        for name in names:
            await connection.request_name(name)
        yield made
    finally:
        connection.disconnect()
        with contextlib.suppress(EOFError, OSError):
            await asyncio.wait_for(_gone(connection), 2)


async def _gone(connection: Any) -> None:
    await connection.wait_for_disconnect()


async def test_a_signal_is_taken_while_it_is_wanted_from_its_owner_alone(bus: BusDaemon) -> None:
    async with started(FLEET.replace("ADDRESS", bus.address)) as bridge, program(bus) as stranger:
        assert bridge.recorder.found(bridge.topic(10)) == []
        async with program(bus, "trbots.gas") as gas:
            await bridge.found(10)
            await gas.emit("trbots.gas", "d", 1.0)
            await asyncio.sleep(0.3)
            assert bridge.values(10) == []
            bridge.want(10, 11)
            await asyncio.sleep(0.3)
            await stranger.emit("trbots.gas", "d", 666.0)
            await gas.emit("trbots.gas", "d", 2.5)
            await gas.emit("trbots.where", "dn", 1.5, -3)
            await until(lambda: bridge.values(10) and bridge.values(11), "the values")
            assert bridge.values(10) == [2.5]
            assert bridge.recorder.samples(bridge.topic(11))[-1].values == (1.5, -3)
            await gas.emit("trbots.gas", "s", "no number")
            await gas.emit("trbots.where", "d", 1.5)
            await until(lambda: bridge.recorder.dropped(Drop.MALFORMED) == 1, "what has too few arguments")
            assert bridge.recorder.dropped(Drop.CONVERSION) == 1
            bridge.want()
            await until(lambda: bridge.statuses(11)[-1] == StatusCode.UNCERTAIN_LAST_USABLE_VALUE, "the rest")
            heard = len(bridge.recorder.samples(bridge.topic(10)))
            await asyncio.sleep(0.2)
            await gas.emit("trbots.gas", "d", 3.0)
            await asyncio.sleep(0.3)
            assert len(bridge.recorder.samples(bridge.topic(10))) == heard
        await until(lambda: bridge.recorder.lost(bridge.topic(10)) == 1, "the loss")


async def test_a_reading_waits_for_one_signal(bus: BusDaemon) -> None:
    async with started(FLEET.replace("ADDRESS", bus.address)) as bridge, program(bus, "trbots.gas") as gas:
        await bridge.found(10)
        reading = bridge.begin(20)
        await asyncio.sleep(0.3)
        await gas.emit("trbots.gas", "d", 4.5)
        ended = await bridge.end(reading)
        assert ended == ExecutionEnded(reading.execution_id, 0, (4.5,))
        assert bridge.values(10) == [4.5]
        nothing = await bridge.end(bridge.begin(20))
        assert "it took longer than 1 s" in nothing.message


async def test_methods_are_called_and_their_errors_told(bus: BusDaemon) -> None:
    async with started(FLEET.replace("ADDRESS", bus.address)) as bridge, program(bus, "trbots.lamp") as lamp:
        ended: Any = await bridge.end(bridge.begin(21, 20, 3))
        assert (ended.status, ended.values) == (0, (23,))
        failed: Any = await bridge.end(bridge.begin(21, 0, 3))
        assert (failed.status, failed.values) == (StatusCode.BAD_UNEXPECTED_ERROR, ())
        assert failed.message == "org.freedesktop.DBus.Error.Failed: nothing to add"
        unknown: Any = await bridge.end(bridge.begin(21, -1, 3))
        assert unknown.message
        assert bridge.driver.publish(LAMP, NUMBER.metadata("lamp"), message_of(LAMP, 0.5))
        await until(lambda: lamp.dimmed == [0.5], "the lamp")


async def test_a_bus_that_comes_late_and_goes(bus: BusDaemon) -> None:
    bus.end()
    async with started(FLEET.replace("ADDRESS", bus.address)) as bridge:
        await until(lambda: "no process listens there" in bridge.driver.status().detail, "the reason")
        assert not bridge.driver.status().connected
        bus.start()
        await until(lambda: bridge.driver.status().connected, "the connection")
        async with program(bus, "trbots.gas"):
            await bridge.found(10)
            bus.end()
            await until(lambda: bridge.recorder.lost(bridge.topic(10)) == 1, "the loss")
        bridge.driver._appears_by = 0.0
        with pytest.raises(RobotOffline, match=r"no program on the D-Bus has the name trbots\.lamp"):
            bridge.begin(21, 1, 2)


async def test_a_flood_of_one_signal_costs_no_other_one() -> None:
    heard: list[tuple[str, Any]] = []
    dropped: list[tuple[str, int]] = []
    tap, gas = (Signal(name, name, "Value") for name in ("trbots.tap", "trbots.gas"))
    bus = bus_module.Bus(
        "session",
        (),
        owned=lambda name, is_owned: None,
        heard=lambda signal, body, _: heard.append((signal.sender, body[0])),
        dropped=lambda signal, count: dropped.append((signal.sender, count)),
        offenders=Offenders(Recorder()),
    )
    bus._outer = asyncio.get_running_loop()
    bus._keep(tap, [True])
    for number in range(100):
        bus._keep(gas, [number])
    await until(lambda: heard, "the signals")
    assert heard == [("trbots.tap", True), *[("trbots.gas", number) for number in range(36, 100)]]
    assert dropped == [("trbots.gas", 36)]


async def test_a_flood_of_signals_is_bounded(bus: BusDaemon) -> None:
    async with started(FLEET.replace("ADDRESS", bus.address)) as bridge, program(bus, "trbots.gas") as gas:
        await bridge.found(10)
        bridge.want(10)
        await asyncio.sleep(0.3)
        for number in range(3000):
            await gas.emit("trbots.gas", "d", float(number))
            if number % 50 == 0:
                await gas.catch_up()
        await until(lambda: bridge.values(10)[-1:] == [2999.0], "the last one")
        assert len(bridge.values(10)) + bridge.recorder.dropped(Drop.RATE_LIMITED) == 3000
        assert len(bridge.values(10)) < 1500


async def test_mistake_of_ours_loses_the_sensors_and_the_bus_is_joined_again(
    bus: BusDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    happens = threading.Event()

    async def mistaken(_: object) -> None:
        while not happens.is_set():
            await asyncio.sleep(0.01)
        raise ValueError("an answer that nobody foresaw")

    monkeypatch.setattr(bus_module, "_ended", mistaken)
    async with started(FLEET.replace("ADDRESS", bus.address)) as bridge, program(bus, "trbots.gas"):
        await bridge.found(10)
        happens.set()
        await until(lambda: bridge.recorder.lost(bridge.topic(10)) == 1, "the loss")
        await until(lambda: "a mistake of the bridge" in bridge.driver.status().detail, "the reason")
        monkeypatch.undo()
        await bridge.found(10, times=2)
        assert bridge.driver.status().connected
