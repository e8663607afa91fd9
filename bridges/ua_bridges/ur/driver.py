"""The driver for a Universal Robots controller."""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from typing import Any, Final

import structlog

from ua_bridges.ur.config import DashboardSkill, RegisterResult, ScriptSkill, UrBridgeConfig, UrSkillMapping
from ua_bridges.ur.link import CommandLink
from ua_bridges.ur.outputs import Output
from ua_bridges.ur.owed_stops import OwedStops
from ua_bridges.ur.remote import RemoteControl
from ua_bridges.ur.sinks import sinks_of, speeds_of
from ua_bridges.ur.speeding import Speeding
from ua_bridges.ur.state import State, remark_of, stop_of
from ua_bridges.ur.task import Forgotten, Progress, RobotTask
from ua_bridges.ur.tasks import keeps_from_moving, make_task, refusal_of
from ua_bridges.ur.telemetry import Telemetry, frequency_of, sources_of, variables_of
from ua_bridges.ur.watching import Faults, Watcher
from ua_fleet.bridge.configured import configured_faults, configured_skills
from ua_fleet.bridge.driver import Driver, DriverStatus, Dropped, Execution, Inlet, Skill
from ua_fleet.bridge.executing import Ended, Executing, Open, ended_text
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.config.schema import FleetConfig
from ua_fleet.counters import Drop
from ua_fleet.errors import BridgeUnavailable, RobotBusy, RobotOffline, SkillError, SkillRejected, SkillTimeout
from ua_fleet.topics import Topic
from ua_fleet.values import StatusCode
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["UrDriver", "create_driver"]

_FOLLOW_S: Final = 0.02
"""Period at which executions under way are looked at."""
_IDLE_S: Final = 0.25

_log = structlog.get_logger(__name__)


class UrDriver(Driver):
    """See `ua_fleet.bridge.driver.Driver`.

    Two threads: the watcher reads the state (see `watching`), the commander does one thing after the other, and follows
    the executions that are under way. Both use ur-rtde in children, with limits.
    """

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        bridge = config.bridges[bridge_name]
        assert isinstance(bridge, UrBridgeConfig)
        self._config = bridge
        self._skills = {skill.topic: skill for skill in configured_skills(config, bridge_name, UrSkillMapping)}
        self._offers = tuple([skill.offer() for skill in self._skills.values()])
        self._sinks = sinks_of(config, bridge_name)
        self._speeds = speeds_of(config, bridge_name)
        self._sources = sources_of(config, bridge_name)
        self._fault_topics = tuple(configured_faults(config, bridge_name).values())
        self._label = bridge_name
        self._link = CommandLink(bridge.address, bridge.answer_timeout_s)
        self._remote = RemoteControl(bridge.address, bridge.answer_timeout_s)
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._claims: dict[bytes, RobotTask] = {}
        """All that was begun or asked about and has not ended, from the event loop's view."""
        self._tasks: dict[bytes, RobotTask] = {}
        """Those that the commander follows."""
        self._asked: list[tuple[Execution, RobotTask]] = []
        """Those that wait for a connection to be asked about."""
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self._watcher: Watcher | None = None
        self._inlet: Inlet | None = None
        self._remote_control: bool | None = None
        self._losses = 0
        self._owed = OwedStops(bridge.address)

    # The event loop's side

    async def start(self, inlet: Inlet) -> None:
        """See Driver."""
        self._inlet = inlet
        self._executing = Executing(inlet.put)
        self._faults = Faults(self._fault_topics, f"{self._label}.fault", inlet.put)
        frequency = frequency_of(self._sources)
        self._watcher = Watcher(
            self._config,
            frequency,
            variables_of(self._sources, self._registers()),
            Telemetry(self._sources, frequency, inlet.put),
            self._faults,
            Offenders(inlet),
        )
        self._stopping.clear()
        self._watcher.start()
        self._thread = threading.Thread(target=self._run, name=f"ur commands {self._config.address}", daemon=True)
        self._thread.start()

    def _registers(self) -> frozenset[tuple[str, int]]:
        """The registers that scripts and programs tell by."""
        ways = [skill.via.way for skill in self._skills.values() if skill.via is not None]
        scripts = [way for way in ways if isinstance(way, ScriptSkill)]
        ends = [way.end_register for way in ways if isinstance(way, DashboardSkill) and way.end_register is not None]
        own = [RegisterResult(register_type="int", place=self._config.first_register + more) for more in (0, 1)]
        results = [result for script in scripts for result in script.results.values()]
        told = [*(own if scripts else ()), *results]
        return frozenset([*((each.register_type, each.place) for each in told), *(("int", place) for place in ends)])

    @property
    def _state(self) -> State | None:
        return self._watcher.state if self._watcher is not None else None

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        assert self._inlet is not None
        sink = self._sinks.get(topic)
        if sink is None:
            self._inlet.put(Dropped(Drop.UNMAPPED))
            return False
        order, output = sink
        (value,) = order.arranged(metadata, message.values)
        if self._state is None:
            self._inlet.put(Dropped(Drop.NOT_CONNECTED, detail=self.status().detail))
            return False
        try:
            method, arguments = output.call(value)
        except ValueError as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=f"{output.name}: {error}"))
            return False
        self._jobs.put(lambda: self._write(output, method, arguments))
        return True

    def setpoint_problem(self, topic: Topic) -> str:
        """See Driver."""
        state = self._state
        if state is None:
            return self.status().detail
        speeding = self._speeds[topic]
        problem = keeps_from_moving(state, self._remote_control)
        if not problem and (problem := speeding.problem()) and speeding.wants_arming():
            self._jobs.put(lambda: speeding.arm(self._link, self._state))
        return problem

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        """See Driver."""
        speeding = self._speeds[topic]
        if speeding.write(values):
            self._jobs.put(lambda: speeding.send(self._link))

    def status(self) -> DriverStatus:
        """See Driver."""
        if self._watcher is None:
            return DriverStatus(False, "not running")
        status, state = self._watcher.status(), self._state
        is_local = self._remote_control is False and self._config.needs_remote_control
        remark = remark_of(state, False if is_local else None) if state is not None else ""
        return replace(status, detail=f"{status.detail}; {remark}") if remark else status

    async def stop(self) -> None:
        """See Driver."""
        watcher, self._watcher = self._watcher, None
        thread, self._thread = self._thread, None
        self._stopping.set()
        if watcher is not None:
            watcher.stop()
            await asyncio.to_thread(watcher.join)
        if thread is not None:
            self._jobs.put(lambda: None)
            await asyncio.to_thread(thread.join)

    def skills(self) -> Sequence[Skill]:
        """See Driver."""
        return self._offers

    def _task_of(self, execution: Execution) -> RobotTask:
        skill = self._skills[execution.topic]
        mark = int.from_bytes(execution.execution_id[:4], "big") & 0x3FFF_FFFF | 0x4000_0000
        return make_task(skill, execution.values, self._config.first_register, mark)

    def execute(self, execution: Execution) -> None:
        """See Driver."""
        task, state = self._task_of(execution), self._state
        if state is None:
            raise RobotOffline(self.status().detail)
        refusal = refusal_of(task, state, self._remote_control)
        if refusal:
            error = SkillRejected(refusal)
            if refusal == stop_of(state):  # the robot itself stands, for whatever it is asked
                error.ua_status = StatusCode.BAD_OUT_OF_SERVICE
            raise error
        if task.moves_arm and any(other.moves_arm for other in list(self._claims.values())):
            raise RobotBusy("the robot is at another move or program")
        if task.moves_arm and self._owed.keeps_from_beginning():
            raise RobotBusy("what ran before has not stopped yet: the controller is told again each second")
        self._claims[execution.execution_id] = task
        self._jobs.put(lambda: self._begin(execution, task))

    def query(self, execution: Execution) -> None:
        """See Driver."""
        task = self._task_of(execution)
        self._claims[execution.execution_id] = task
        self._jobs.put(lambda: self._ask(execution, task))

    def halt(self, execution: Execution) -> None:
        """See Driver."""
        task, state = self._claims.get(execution.execution_id), self._state
        if state is None:
            raise RobotOffline(self.status().detail)
        if task is None:
            raise SkillRejected("the robot is not at it")
        task.check_can_halt()
        self._jobs.put(lambda: self._halt(execution, task))

    # The commander's thread

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                try:
                    job = self._next_job()
                    self._leave_dead_link()
                    if job is not None:
                        job()
                    self._turn(time.monotonic())
                except Exception:  # noqa: BLE001 - one command that we got wrong is not the end of all others
                    _log.exception("a mistake of the bridge; report this log", controller=self._config.address)
        finally:
            self._link.close()
            self._remote.close()

    def _next_job(self) -> Callable[[], None] | None:
        with suppress(queue.Empty):
            return self._jobs.get(timeout=_FOLLOW_S if self._tasks or self._driven() else _IDLE_S)
        return None

    def _driven(self) -> list[Speeding]:
        """The arm, while it is driven by hand."""
        return [each for each in self._speeds.values() if each.is_armed]

    def _leave_dead_link(self) -> None:
        """Where the state's connection was lost those for commands are dead too, and ur-rtde would wait for them."""
        losses = self._watcher.losses if self._watcher is not None else self._losses
        if losses != self._losses:
            self._losses = losses
            self._link.close()
            self._remote.close()

    def _turn(self, now: float) -> None:
        if driven := self._driven():
            self._look_at_remote_control(now)
            for speeding in driven:
                speeding.look(self._link, lambda: self._state, now)
        for speeding in self._speeds.values():
            if speeding.take_failure():
                self._owed.may_be_paused(now)
        if driven:
            return  # the robot executes nothing else, and nothing must keep its speeds waiting
        state = self._state
        if state is not None:
            for execution, task in self._asked:
                task.resume(state, now)
                self._tasks[execution.execution_id] = task
            self._asked.clear()
            self._look_at_remote_control(now)
            self._owed.settle(self._tasks, self._link, state, now)
            for execution_id, task in list(self._tasks.items()):
                try:
                    self._follow(execution_id, task, state, now)
                except Exception as error:  # noqa: BLE001 - the others are followed all the same
                    _log.exception("a mistake of the bridge; report this log", controller=self._config.address)
                    self._forget(execution_id, f"a mistake of the bridge ({error!r}); see what the robot does")
        for overdue in self._executing.overdue(now):
            self._give_up(overdue, state)

    def _look_at_remote_control(self, now: float) -> None:
        if not (self._skills or self._sinks or self._speeds):
            return
        said = self._remote.look(now)
        if said is not None:
            self._remote_control = said

    def _begin(self, execution: Execution, task: RobotTask) -> None:
        now, state = time.monotonic(), self._state
        self._executing.begin(self._skills[execution.topic], execution, now)
        self._tasks[execution.execution_id] = task
        try:
            for speeding in self._driven():
                speeding.leave(self._link, lambda: self._state)
                state = self._state
            if state is None:
                raise RobotOffline(self.status().detail)
            task.begin(self._link, state, now)
        except SkillTimeout as error:
            if task.is_told:  # it may have begun: what the controller shows has to tell
                task.is_unsure = True
                _log.debug("a command was not answered", controller=self._config.address, reason=str(error))
            else:
                status = int(StatusCode.BAD_NO_COMMUNICATION)
                self._end(execution.execution_id, Ended(status, (), ended_text(str(error))))
        except SkillError as error:
            self._end(execution.execution_id, Ended(int(error.ua_status), (), ended_text(str(error))))

    def _ask(self, execution: Execution, task: RobotTask) -> None:
        self._executing.begin(self._skills[execution.topic], execution, time.monotonic())
        self._asked.append((execution, task))

    def _end(self, execution_id: bytes, ended: Ended) -> None:
        self._tasks.pop(execution_id, None)
        self._claims.pop(execution_id, None)
        self._executing.end(execution_id, ended)

    def _follow(self, execution_id: bytes, task: RobotTask, state: State, now: float) -> None:
        try:
            told = task.look(self._link, state, now)
        except SkillError as error:
            _log.debug("what the controller does is followed by its state alone", reason=str(error))
            self._link.close()
            return
        if isinstance(told, Progress):
            self._executing.progress(execution_id, told.fraction, told.message)
        elif isinstance(told, Ended):
            if task.moves_arm and told.status == StatusCode.BAD_OUT_OF_SERVICE:
                self._owed.has_failed(self._link, now)
            self._end(execution_id, told)
        elif isinstance(told, Forgotten):
            self._forget(execution_id, told.message)

    def _forget(self, execution_id: bytes, why: str) -> None:
        self._tasks.pop(execution_id, None)
        self._claims.pop(execution_id, None)
        self._executing.forget(execution_id, why)

    def _halt(self, execution: Execution, task: RobotTask) -> None:
        state = self._state
        if state is None or execution.execution_id in self._tasks:
            self._owed.halt(execution.execution_id, task, self._link, state, time.monotonic())

    def _give_up(self, opened: Open, state: State | None) -> None:
        execution_id = opened.execution_id
        task = self._tasks.get(execution_id)
        is_halted = False
        if task is not None and task.moves_arm and state is not None:
            is_halted = self._owed.give_up(execution_id, task, self._link, state, time.monotonic())
        self._asked = [asked for asked in self._asked if asked[0].execution_id != execution_id]
        self._end(execution_id, opened.too_long(is_halted=is_halted))

    def _write(self, output: Output, method: str, arguments: list[Any]) -> None:
        assert self._inlet is not None
        try:
            taken = self._link.call("io", method, *arguments)
        except SkillTimeout as error:
            self._inlet.put(Dropped(Drop.NO_ANSWER, detail=f"{output.name}: {error}"))
        except SkillError as error:
            self._inlet.put(Dropped(Drop.REJECTED, detail=f"{output.name}: {error}"))
        else:
            if not taken:
                self._inlet.put(Dropped(Drop.REJECTED, detail=f"{output.name}: the controller did not take it"))


def create_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """The driver of the Universal Robots bridge with this name in `fleet.yaml`.

    Raises:
        BridgeUnavailable: ur-rtde is not installed.
    """
    if find_spec("rtde_receive") is None:
        raise BridgeUnavailable("ur-rtde is missing (it exists for x86-64 alone)", extra="ur")
    return UrDriver(config, bridge_name)
