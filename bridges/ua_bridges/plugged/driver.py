"""The driver for plugged-in sensors and actuators: which device a value or a skill belongs to, and when it is due."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

from ua_bridges.plugged.bus import Bus, Signal
from ua_bridges.plugged.calls import ended_of, method_of
from ua_bridges.plugged.config import Device, PluggedBridgeConfig, PluggedSink, PluggedSkill, PluggedSource
from ua_bridges.plugged.data import as_type
from ua_bridges.plugged.devices import DeviceFacts, Plugged, Unplugged
from ua_bridges.plugged.files import AttributeFiles
from ua_bridges.plugged.lines import Lines, PluggedSkillSpec
from ua_bridges.plugged.port import Port
from ua_bridges.plugged.programs import Programs
from ua_bridges.plugged.sensor import Sensor
from ua_bridges.plugged.udev import PathWatch, UdevWatch
from ua_fleet.bridge.configured import ConfiguredData, configured_sinks, configured_skills, configured_sources
from ua_fleet.bridge.driver import Driver, DriverStatus, Dropped, Execution, Inlet, Skill
from ua_fleet.bridge.executing import Ended, Executing, halted
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotOffline, SkillError, SkillRejected
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["PluggedDriver", "create_driver"]

APPEARS_S: Final = 3.0
"""So long after the start a device that is plugged in has been found and opened."""
CALL_S: Final = 5.0
"""A method that a value is handed to has to return within this."""

logger = logging.getLogger(__name__)


class _Device:
    """One rule of the configuration, with what is read and driven on the device."""

    def __init__(self, name: str, config: Device) -> None:
        self.name, self.config = name, config
        self.facts: DeviceFacts | None = None
        self.there: DeviceFacts | None = None
        """What is plugged in, also while it is put aside, and `facts` are None."""
        self.aside = ""
        """Why it is put aside."""
        self.aside_until = 0.0
        self.lines: Lines | None = None
        self.port: Port | None = None
        self.files: AttributeFiles | None = None
        self.constants: list[Sensor] = []
        """Those whose value is that the device is there, or where."""

    @property
    def is_ready(self) -> bool:
        """Whether it can be read and driven."""
        return self.facts is not None and (self.lines is None or self.lines.is_open)

    def detail(self) -> str:
        """One line for people."""
        if self.aside:
            return f"{self.name}: {self.aside}; it is put aside, and tried again"
        if self.facts is None:
            rule = self.config.match
            what = self.config.path if rule is None else rule.model_dump_json(exclude_defaults=True)
            return f"{self.name}: waiting for {what} to be plugged in"
        said = self.port.detail if self.port is not None else ""
        return f"{self.name}: {said or f'plugged in at {self.facts.place}'}"


class PluggedDriver(Driver):
    """See `ua_fleet.bridge.driver.Driver`."""

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, PluggedBridgeConfig)
        self._config = bridge
        self._skills = {skill.topic: skill for skill in configured_skills(config, bridge_name, PluggedSkill)}
        self._offers = tuple([skill.offer() for skill in self._skills.values() if skill.via is not None])
        self._sources = configured_sources(config, bridge_name, PluggedSource)
        self._sinks = {data.topic: data for data in configured_sinks(config, bridge_name, PluggedSink)}
        self._sensors: dict[Topic, Sensor] = {}
        self._signals: dict[Signal, list[Sensor]] = {}
        self._followed: set[Signal] = set()
        self._devices: dict[str, _Device] = {}
        self._programs: Programs | None = None
        self._bus: Bus | None = None
        self._udev: UdevWatch | None = None
        self._paths: PathWatch | None = None
        self._inlet: Inlet | None = None
        self._executing: Executing | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._early: list[Execution] = []
        """What was asked before its device can have been found."""
        self._appears_by = 0.0
        self._turn_is_due = False
        self._is_stopped = False
        self._failure = ""
        """The mistake of ours after which nothing is done in time any more."""

    # Life

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet, self._loop, self._offenders = inlet, asyncio.get_running_loop(), Offenders(inlet)
        self._appears_by = time.monotonic() + APPEARS_S
        self._executing = executing = Executing(inlet.put)
        self._sensors = {data.topic: Sensor(data, inlet.put, executing) for data in self._sources}
        self._devices = {name: _Device(name, device) for name, device in self._config.devices.items()}
        for device in self._devices.values():
            self._equip(device, inlet, executing)
        self._start_bus()
        rules = {name: device.match for name, device in self._config.devices.items() if device.match is not None}
        paths = {name: device.path for name, device in self._config.devices.items() if device.path is not None}
        self._udev, self._paths = UdevWatch(rules, self._changed), PathWatch(paths, self._changed)
        self._udev.start()
        self._paths.start()

    def _equip(self, device: _Device, inlet: Inlet, executing: Executing) -> None:
        sensors = [sensor for sensor in self._sensors.values() if sensor.source.device == device.name]
        skills = [skill for skill in self._skills.values() if skill.via is not None and skill.via.device == device.name]
        sinks = [data for data in self._sinks.values() if data.side.device == device.name]
        on_line = [sensor for sensor in sensors if sensor.source.line is not None]
        if on_line or skills or sinks:
            settings = device.config.port
            device.port = port = Port(device.name, settings, self._soon)
            device.lines = Lines(
                device.name,
                settings,
                on_line,
                skills,
                sinks,
                inlet.put,
                executing,
                port.write,
                port.write_newest,
                port.reset,
                port.listen,
                partial(self._soon_aside, device),
            )
            port.attach(device.lines)
        in_files = [sensor for sensor in sensors if sensor.source.attribute is not None]
        if in_files:
            device.files = AttributeFiles(in_files, self._soon)
        device.constants = [
            sensor for sensor in sensors if sensor.source.url is not None or sensor.source.plugged is not None
        ]

    def _start_bus(self) -> None:
        for sensor in self._sensors.values():
            source = sensor.source
            if source.signal is not None:
                signal = Signal(source.sender or source.signal, source.signal, source.member)
                self._signals.setdefault(signal, []).append(sensor)
        self._programs = Programs(self._signals, self._offenders)
        names = [signal.sender for signal in self._signals]
        calls = [skill.via.call for skill in self._skills.values() if skill.via is not None]
        calls += [data.side.call for data in self._sinks.values()]
        names += [call.name for call in calls if call is not None]
        if names:
            self._bus = Bus(
                self._config.bus,
                names,
                owned=self._name_owned,
                heard=self._signal_heard,
                dropped=self._signals_lost,
                offenders=self._offenders,
            )
            self._bus.start()

    async def stop(self) -> None:
        """See Driver."""
        self._is_stopped = True
        if self._timer is not None:
            self._timer.cancel()
        for watch in (self._udev, self._paths):
            if watch is not None:
                watch.stop()
        for device in self._devices.values():
            if device.port is not None:
                await device.port.stop()
            device.facts = device.there = None
        if self._bus is not None:
            self._bus.stop()

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._failure:
            return DriverStatus(False, self._failure, is_over=True)
        details = [device.detail() for device in self._devices.values()]
        is_connected = any(device.is_ready for device in self._devices.values())
        if self._bus is not None:
            details.append(self._bus.detail)
            is_connected = is_connected or self._bus.is_connected
        each = {name: "" if device.is_ready else device.detail() for name, device in self._devices.items()}
        if self._bus is not None:
            each["D-Bus"] = "" if self._bus.is_connected else self._bus.detail
        text = "; ".join(details) or "there is nothing to watch"
        aside = self._offenders.told(time.monotonic()) if self._inlet is not None else dict[str, str]()
        return DriverStatus(is_connected and not self._is_stopped, text, each if len(each) > 1 else {}, aside)

    # Devices

    def _changed(self, changes: Sequence[Plugged | Unplugged]) -> None:
        for change in changes:
            device = self._devices[change.rule]
            device.there = change.device if isinstance(change, Plugged) else None
            if device.aside:
                continue
            if device.there is not None:
                self._plugged(device, device.there)
            else:
                self._unplugged(device, f"{device.name} was unplugged")
        self._turn()

    def _soon_aside(self, device: _Device, reason: str) -> None:
        """Put it aside when what it is at is over."""
        self._loop.call_soon(self._put_aside, device, reason)

    def _put_aside(self, device: _Device, reason: str) -> None:
        """Let go of a device that misbehaves; it is tried again as if it were plugged in then."""
        if device.aside or self._is_stopped:
            return
        now = time.monotonic()
        device.aside_until = now + self._offenders.put_aside(device.name, reason, now)
        device.aside = reason
        if device.facts is not None:
            self._unplugged(device, f"{device.name} is put aside: {reason}")
        self._turn()

    def _try_again(self, device: _Device) -> None:
        device.aside = ""
        if device.there is not None:
            self._plugged(device, device.there)

    def _plugged(self, device: _Device, facts: DeviceFacts) -> None:
        device.facts = facts
        now = time.monotonic()
        if device.port is not None and facts.node is not None:
            device.port.plugged(facts.node)
        if device.files is not None:
            device.files.plugged(facts.id)
        for sensor in device.constants:
            sensor.plugged(now, time.time_ns())
            self._tell_constant(sensor)

    def _unplugged(self, device: _Device, why: str) -> None:
        device.facts, self._appears_by = None, 0.0  # what is pulled out had been found
        if device.port is not None:
            device.port.unplugged(why)
        if device.files is not None:
            device.files.unplugged(why)
        for sensor in device.constants:
            sensor.unplugged(why, time.monotonic())

    def _tell_constant(self, sensor: Sensor) -> None:
        ((name, _),) = sensor.data.types.items()
        value: Any = sensor.source.url if sensor.source.url is not None else True
        sensor.show({name: value}, time.monotonic(), time.time_ns())

    # D-Bus

    def _name_owned(self, name: str, is_owned: bool) -> None:
        if self._is_stopped:
            return
        assert self._programs is not None
        self._programs.owned(name, is_owned, time.monotonic(), time.time_ns())
        self._turn()

    def _is_on_bus(self, name: str) -> bool:
        return self._programs is not None and self._programs.is_there(name)

    def _signal_heard(self, signal: Signal, body: Sequence[Any], time_ns: int) -> None:
        assert self._programs is not None
        self._programs.heard(signal, body, time.monotonic(), time_ns)
        self._turn()

    def _signals_lost(self, signal: Signal, count: int) -> None:
        assert self._inlet is not None
        self._inlet.put(Dropped(Drop.RATE_LIMITED, count, f"{signal.interface}: more signals than can be looked at"))

    # What is wanted and asked

    def want(self, wanted: frozenset[Topic]) -> None:
        """See Driver."""
        now = time.monotonic()
        for topic, sensor in self._sensors.items():
            sensor.want(topic in wanted, now)
        self._turn()

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        assert self._inlet is not None
        data = self._sinks.get(topic)
        if data is None:
            self._inlet.put(Dropped(Drop.UNMAPPED))
            return False
        values = data.order.arranged(metadata, message.values)
        for device in self._devices.values():
            if device.lines is not None and device.lines.writes(topic):
                return device.lines.inform(topic, values)
        return self._inform_by_call(data, values, self._inlet)

    def _inform_by_call(self, data: ConfiguredData[PluggedSink], values: Sequence[Any], inlet: Inlet) -> bool:
        call, bus = data.side.call, self._bus
        assert call is not None
        assert bus is not None
        fitting = [as_type(name, kind, value) for (name, kind), value in zip(data.types.items(), values, strict=True)]
        for value in fitting:
            if isinstance(value, ValueError):
                inlet.put(Dropped(Drop.CONVERSION, detail=f"{data.label}: {value}"))
                return False
        if not self._is_on_bus(call.name):
            inlet.put(
                Dropped(Drop.NOT_CONNECTED, detail=f"{data.label}: no program on the D-Bus has the name {call.name}")
            )
            return False

        def done(answer: Any) -> None:
            if answer.problem:
                inlet.put(Dropped(Drop.REJECTED, detail=f"{data.label}: {answer.problem}"))

        bus.call(method_of(call, tuple(data.types.values()), fitting, CALL_S), done)
        return True

    # Skills

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        return self._offers

    def execute(self, execution: Execution) -> None:
        """See Driver. What is asked before the devices can have been found waits for its device a little."""
        assert self._executing is not None
        skill, now = self._skills[execution.topic], time.monotonic()
        if now < self._appears_by and not self._is_ready(skill):
            self._executing.begin(skill, execution, now)
            self._early.append(execution)
        else:
            self._do(skill, execution, now)
        self._turn()

    def _is_ready(self, skill: PluggedSkillSpec) -> bool:
        via = skill.via
        assert via is not None, "the configuration was checked"
        if via.read is not None:
            sensor = self._sensor(skill.robot, via.read)
            return sensor is not None and sensor.is_plugged
        return self._is_on_bus(via.call.name) if via.call is not None else self._lines_of(skill).is_open

    def _do(self, skill: PluggedSkillSpec, execution: Execution, now: float) -> None:
        via = skill.via
        assert via is not None, "the configuration was checked"
        if via.read is not None:
            self._read(skill, via.read, execution, now)
        elif via.call is not None:
            self._call(skill, execution, now)
        else:
            self._lines_of(skill).execute(skill, execution, now)

    def _do_early(self, now: float) -> None:
        """Begin what has waited for its device, or say that the device is not there."""
        assert self._executing is not None
        waiting, self._early = self._early, []
        for execution in waiting:
            skill = self._skills[execution.topic]
            if now < self._appears_by and not self._is_ready(skill):
                self._early.append(execution)
                continue
            try:
                self._do(skill, execution, now)
            except SkillError as error:
                self._executing.end(execution.execution_id, Ended(error.ua_status, (), str(error)))

    def _lines_of(self, skill: PluggedSkillSpec) -> Lines:
        assert skill.via is not None
        lines = self._devices[skill.via.device or ""].lines
        assert lines is not None
        return lines

    def _sensor(self, robot: str, name: str) -> Sensor | None:
        return next(
            (each for each in self._sensors.values() if (each.data.robot, each.data.name) == (robot, name)), None
        )

    def _read(self, skill: PluggedSkillSpec, name: str, execution: Execution, now: float) -> None:
        sensor = self._sensor(skill.robot, name)
        if sensor is None or not sensor.is_plugged:
            raise RobotOffline(f"{skill.robot}.{name} is not plugged in; plug it in, and see the bridge's status")
        sensor.read(skill, execution, now)
        if sensor.source.url is not None or sensor.source.plugged is not None:
            self._tell_constant(sensor)
            return
        device = self._devices.get(sensor.source.device or "")
        if device is None:
            return
        if device.lines is not None:
            device.lines.read(sensor, now)
        if device.files is not None:
            device.files.read(sensor, now)

    def _call(self, skill: PluggedSkillSpec, execution: Execution, now: float) -> None:
        assert skill.via is not None
        assert self._executing is not None
        call, bus, executing = skill.via.call, self._bus, self._executing
        assert call is not None
        assert bus is not None
        if not self._is_on_bus(call.name):
            raise RobotOffline(
                f"no program on the D-Bus has the name {call.name}; start its program, and see the bridge's status"
            )
        types = [argument.type for argument in skill.config.arguments.values()]
        results = {name: result.type for name, result in skill.config.results.items()}
        executing.begin(skill, execution, now)
        executing.progress(execution.execution_id, 0.0)

        def done(answer: Any) -> None:
            if not self._is_stopped and executing.get(execution.execution_id) is not None:
                executing.end(execution.execution_id, ended_of(answer, results))

        bus.call(method_of(call, types, execution.values, skill.config.timeout_s), done)

    def query(self, execution: Execution) -> None:
        """See Driver: devices remember nothing that could be asked for, but a reading may be begun anew."""
        assert self._executing is not None
        skill = self._skills[execution.topic]
        self._executing.begin(skill, execution, time.monotonic())
        if skill.via is not None and skill.via.read is not None:
            self._executing.never(execution.execution_id)
        else:
            self._executing.forget(execution.execution_id, "the device cannot be asked; see what it did")

    def halt(self, execution: Execution) -> None:
        """See Driver."""
        assert self._executing is not None
        via = self._skills[execution.topic].via
        assert via is not None
        if execution in self._early or via.read is not None:
            if self._leave(execution.execution_id):
                self._executing.end(execution.execution_id, halted())
        elif via.call is not None:
            raise SkillRejected("a D-Bus method cannot be stopped; give the skill that stops it a method of its own")
        else:
            self._lines_of(self._skills[execution.topic]).halt(execution, time.monotonic())
        self._turn()

    def _leave(self, execution_id: bytes) -> bool:
        early = [execution for execution in self._early if execution.execution_id == execution_id]
        self._early = [execution for execution in self._early if execution.execution_id != execution_id]
        return bool(early) or any(sensor.leave(execution_id, time.monotonic()) for sensor in self._sensors.values())

    # Time

    def _soon(self) -> None:
        """Something was heard: look, once for all that comes together."""
        if not self._turn_is_due and not self._is_stopped:
            self._turn_is_due = True
            self._loop.call_soon(self._turn)

    def _turn(self) -> None:
        """Do what is due, see who is needed, and set the timer."""
        self._turn_is_due = False
        if self._is_stopped or self._failure:
            return
        now = time.monotonic()
        try:
            due = self._do_due(now)
        except Exception as error:  # logged, and told as the driver's status
            logger.exception("what was due could not be done")
            self._failure = f"a mistake of the bridge ({error!r}); report its log, and start it again"
            return
        if self._timer is not None:
            self._timer.cancel()
        self._timer = None if due is None else self._loop.call_later(max(due - now, 0.0), self._turn)

    def _do_due(self, now: float) -> float | None:
        """Do what is due; when the next thing is."""
        self._give_up(now)
        self._do_early(now)
        times: list[float | None] = [self._appears_by if self._early else None]
        for device in self._devices.values():
            try:
                times += self._work(device, now)
            except Exception as error:  # one device, one mistake
                logger.exception("device %s made the bridge fail", device.name)
                self._soon_aside(device, f"a mistake of the bridge ({error!r}); report its log")
        if self._programs is not None:
            times += self._programs.turn(now, time.time_ns())
        for signal, sensors in self._signals.items():
            self._follow(signal, any(sensor.is_needed for sensor in sensors))
        assert self._executing is not None
        times.append(self._executing.due())
        return min((at for at in times if at is not None), default=None)

    def _work(self, device: _Device, now: float) -> list[float | None]:
        """Do what is due on one device; when the next things are."""
        if device.aside:
            if now < device.aside_until:
                return [device.aside_until]
            self._try_again(device)
        if device.port is not None:
            device.port.listen()
        times = [device.lines.turn(now) if device.lines is not None else None]
        times.append(device.files.turn(now) if device.files is not None else None)
        return times + [sensor.turn(now) for sensor in device.constants]

    def _follow(self, signal: Signal, is_followed: bool) -> None:
        if is_followed != (signal in self._followed) and self._bus is not None:
            (self._followed.add if is_followed else self._followed.discard)(signal)
            self._bus.follow(signal, is_followed)

    def _give_up(self, now: float) -> None:
        """End what has taken longer than its skill's timeout."""
        assert self._executing is not None
        for opened in self._executing.overdue(now):
            if any(device.lines.overdue(opened) for device in self._devices.values() if device.lines is not None):
                continue
            self._leave(opened.execution_id)
            ended = opened.too_long(is_halted=False, otherwise="see what the device does")
            self._executing.end(opened.execution_id, ended)


def create_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """The driver of the bridge to plugged-in devices with this name in `fleet.yaml`."""
    return PluggedDriver(config, bridge_name)
