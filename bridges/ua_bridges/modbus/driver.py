"""The Modbus driver: one thread with an event loop of its own, in which each device has its task."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import structlog

from ua_bridges.modbus.config import HandshakeSkill, ModbusBridgeConfig
from ua_bridges.modbus.device import Device, SinkWrite, check_fits
from ua_bridges.modbus.handshake import SkillRegisters
from ua_bridges.modbus.job import Handshake, check_can_halt
from ua_bridges.modbus.link import Line
from ua_bridges.modbus.memory import HandshakeMemory
from ua_bridges.modbus.sinks import sink_specs
from ua_bridges.modbus.sources import source_specs
from ua_fleet.bridge.configured import ConfiguredSkill, configured_skills
from ua_fleet.bridge.driver import Driver, DriverStatus, Dropped, Execution, Inlet, Skill
from ua_fleet.bridge.executing import Executing
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import DriverFailed, RobotBusy, RobotOffline, SkillRejected, UaFleetError
from ua_fleet.registers import RegisterUnfit
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["ModbusDriver", "create_driver"]

_log = structlog.get_logger("ua_bridges.modbus")

MEMORY: Final = "handshakes.db"
"""In the bridge's state folder: which number each execution has."""
_FIRST_S: Final = 2.0
"""At the start, devices that are there are waited for so long: then they can be commanded at once."""
_CLOSING_S: Final = 0.02
_LISTED: Final = 3
"""Devices that are away and are named in the status."""


class ModbusDriver(Driver):
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        """Make a driver of a bridge in a configuration that was checked."""
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, ModbusBridgeConfig)
        self._bridge, self._folder = bridge, Path.cwd()
        self._sources = source_specs(config, bridge_name)
        self._sinks = {sink.topic: sink for sink in sink_specs(config, bridge_name)}
        skills = configured_skills(config, bridge_name, HandshakeSkill)
        self._skills = {skill.topic: self._registers(skill) for skill in skills if skill.via is not None}
        self._offers = tuple([registers.skill.offer() for registers in self._skills.values()])
        self._devices: dict[str, Device] = {}
        self._handshakes: dict[str, Handshake] = {}
        self._taken: dict[str, bytes] = {}
        """The execution that has each handshake, or is about to."""
        self._thread: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop: asyncio.Event | None = None
        self._inlet: Inlet | None = None
        self._failure = ""

    def remember_in(self, folder: Path) -> None:
        """See Driver."""
        self._folder = folder

    # The bridge's event loop

    async def start(self, inlet: Inlet) -> None:
        """See Driver.

        Raises:
            BridgeUnavailable: a file of TLS cannot be used.
            StorageUnavailable: what has to be remembered of skills cannot be.
        """
        self._inlet, self._offenders = inlet, Offenders(inlet)
        started: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        tell = asyncio.get_running_loop().call_soon_threadsafe

        def begun(error: BaseException | None) -> None:
            if started.done():
                return
            if error is None:
                started.set_result(None)
            else:
                started.set_exception(error)

        def told(error: BaseException | None) -> None:
            tell(begun, error)

        self._thread = threading.Thread(target=self._run, args=(told,), name="modbus", daemon=True)
        self._thread.start()
        await started

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        assert self._inlet is not None
        sink = self._sinks.get(topic)
        if sink is None:
            self._inlet.put(Dropped(Drop.UNMAPPED))
            return False
        values = sink.order.arranged(metadata, message.values)
        try:
            check_fits(sink, values)
        except RegisterUnfit as unfit:
            self._inlet.put(Dropped(Drop.CONVERSION, 1, unfit.reason))
            return False
        device = self._devices.get(sink.device)
        if device is None or not (device.is_there or sink.rewrite):
            self._inlet.put(Dropped(Drop.NOT_CONNECTED, 1, f"{sink.name}: {sink.device} does not answer"))
            return False
        self._call(device.take, SinkWrite(sink, values))
        return True

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._failure:
            return DriverStatus(False, self._failure, is_over=True)
        if self._thread is None or not self._devices:
            return DriverStatus(False, "not running")
        away = [device.detail for device in self._devices.values() if not device.is_there]
        each = {name: "" if device.is_there else device.detail for name, device in self._devices.items()}
        several = each if len(each) > 1 else {}
        aside = self._offenders.told(time.monotonic())
        if not away:
            return DriverStatus(True, "; ".join(device.detail for device in self._devices.values()), several, aside)
        more = f" and {len(away) - _LISTED} more" if len(away) > _LISTED else ""
        there = len(self._devices) - len(away)
        counted = f"{there} of {len(self._devices)} devices answer; " if len(self._devices) > 1 else ""
        return DriverStatus(False, counted + "; ".join(away[:_LISTED]) + more, several, aside)

    async def stop(self) -> None:
        """See Driver."""
        thread, self._thread = self._thread, None
        if thread is not None:
            if self._stop is not None:
                self._call(self._stop.set)
            await asyncio.to_thread(thread.join)
        self._devices, self._loop, self._stop = {}, None, None

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        return self._offers

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        registers = self._skills[execution.topic]
        name, device = self._place(registers)
        if not device.is_there:
            raise RobotOffline(f"{registers.skill.robot} cannot be reached: {device.detail}")
        if name in self._taken:
            raise RobotBusy(f"{registers.skill.robot} is busy; its device takes one skill at a time")
        try:
            writes = registers.writes(execution.values)
        except RegisterUnfit as unfit:
            raise SkillRejected(f"{registers.skill.label}: {unfit.reason}") from unfit
        self._taken[name] = execution.execution_id
        self._call(self._handshakes[name].begin, registers, execution, writes)
        self._call(device.wake)

    def query(self, execution: Execution) -> None:
        """See Driver."""
        registers = self._skills[execution.topic]
        name, device = self._place(registers)
        self._taken.setdefault(name, execution.execution_id)
        self._call(self._handshakes[name].ask, registers, execution)
        self._call(device.wake)

    def halt(self, execution: Execution) -> None:
        """See Driver."""
        registers = self._skills[execution.topic]
        check_can_halt(registers)
        name, device = self._place(registers)
        self._call(self._handshakes[name].halt, execution.execution_id)
        self._call(device.wake)

    def _place(self, registers: SkillRegisters) -> tuple[str, Device]:
        """The handshake of a skill, and its device."""
        device = self._bridge.device_of(registers.via.device)
        assert device is not None, "the configuration was checked"
        there = self._devices.get(device)
        if there is None:
            raise RobotOffline("the bridge is not running")
        return _handshake_name(device, registers), there

    def _registers(self, skill: ConfiguredSkill[HandshakeSkill]) -> SkillRegisters:
        assert skill.via is not None
        device = self._bridge.device_of(skill.via.device)
        assert device is not None, "the configuration was checked"
        return SkillRegisters(skill, self._bridge.devices[device])

    def _call(self, function: Callable[..., object], *arguments: object) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # it is ending
                self._loop.call_soon_threadsafe(function, *arguments)

    # The thread of the driver

    def _run(self, begun: Callable[[BaseException | None], None]) -> None:
        try:
            asyncio.run(self._serve(begun))
        except BaseException as error:  # noqa: BLE001 - whoever waits for the start, or sees the status, has to hear of it
            first = _first_of(error)
            is_known = isinstance(first, UaFleetError)
            why = str(first) if is_known else f"a mistake of the bridge ({first!r}); report its log"
            self._failure = f"the driver failed: {why}; start the bridge again"
            if not is_known:
                _log.error("the driver failed", exc_info=error)
            for device in self._devices.values():
                device.end(self._failure)
            begun(first if is_known else DriverFailed(self._failure))

    async def _serve(self, begun: Callable[[BaseException | None], None]) -> None:
        assert self._inlet is not None
        put, loop = self._inlet.put, asyncio.get_running_loop()
        loop.set_exception_handler(self._on_error)
        self._stop = asyncio.Event()
        lines: dict[tuple[object, ...], Line] = {}
        with contextlib.ExitStack() as cleanup:
            memory: HandshakeMemory | None = None
            if self._skills:
                memory = HandshakeMemory(self._folder / MEMORY)
                cleanup.callback(memory.close)
            self._handshakes = self._make_handshakes(memory, Executing(put))
            devices = {name: self._make_device(name, lines) for name in self._bridge.devices}
            for line in lines.values():
                cleanup.callback(line.close)
            self._devices, self._loop = devices, loop
            async with asyncio.TaskGroup() as tasks:
                running = {tasks.create_task(device.run(), name=f"modbus {name}") for name, device in devices.items()}
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_FIRST_S):
                        for device in devices.values():
                            await device.asked.wait()
                begun(None)
                await self._stop.wait()
                while running:  # Python 3.11's wait_for loses a cancellation that comes together with an answer
                    for task in running:
                        task.cancel()
                    _, running = await asyncio.wait(running, timeout=0.1)
        await asyncio.sleep(_CLOSING_S)  # asyncio closes a connection in its next turns

    def _on_error(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """What nobody has caught: an answer that the library cannot decode, else a mistake of ours, which is logged.

        The request that was answered so ends as not answered.
        """
        assert self._inlet is not None
        error = context.get("exception")
        if isinstance(error, Exception) and _was_receiving(error):
            said = " ".join(str(error).split())
            self._inlet.put(Dropped(Drop.MALFORMED, 1, f"an answer cannot be decoded: {said[:120]}"))
        else:
            loop.default_exception_handler(context)

    def _make_handshakes(self, memory: HandshakeMemory | None, executing: Executing) -> dict[str, Handshake]:
        assert self._inlet is not None
        made: dict[str, Handshake] = {}
        for registers in self._skills.values():
            device = self._bridge.device_of(registers.via.device)
            assert device is not None
            assert memory is not None
            name = _handshake_name(device, registers)
            if name not in made:
                made[name] = Handshake(name, memory, executing, self._inlet.put, partial(self._free, name))
        return made

    def _free(self, name: str, execution_id: bytes) -> None:
        if self._taken.get(name) == execution_id:
            del self._taken[name]

    def _make_device(self, name: str, lines: dict[tuple[object, ...], Line]) -> Device:
        assert self._inlet is not None
        config = self._bridge.devices[name]
        key = (config.host, config.tcp_port, config.serial and config.serial.tty)
        if key not in lines:
            sharing = [
                other.timeout_s
                for other in self._bridge.devices.values()
                if (other.host, other.tcp_port, other.serial and other.serial.tty) == key
            ]
            lines[key] = Line(config, self._folder, max(sharing))
        return Device(
            name,
            config,
            lines[key],
            [source for source in self._sources if source.device == name],
            [handshake for where, handshake in self._handshakes.items() if where.startswith(f"{name}:")],
            self._inlet.put,
            self._offenders,
        )


def _handshake_name(device: str, registers: SkillRegisters) -> str:
    return f"{device}:{registers.request.address}"


def _was_receiving(error: Exception) -> bool:
    """Whether it was raised in what a device had sent. A serial line is no transport of asyncio, which would say so."""
    return any(frame.f_code.co_name == "data_received" for frame, _ in traceback.walk_tb(error.__traceback__))


def _first_of(error: BaseException) -> BaseException:
    """What a group of errors began with."""
    if isinstance(error, BaseExceptionGroup):
        return cast("BaseExceptionGroup[BaseException]", error).exceptions[0]
    return error


def create_driver(config: FleetConfig, bridge_name: str) -> ModbusDriver:
    """The driver of the Modbus bridge with this name in `fleet.yaml`, not started."""
    return ModbusDriver(config, bridge_name)
