"""Skills by handshake when the PLC's program stands still, loses its memory, or is busy with something else."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncGenerator
from pathlib import Path

import pytest
from ua_bridges.modbus import job
from ua_bridges.modbus.driver import ModbusDriver, create_driver
from ua_bridges.modbus.memory import HandshakeMemory

from tests.contract.harness import Recorder
from tests.contract.modbus import FLEET, PlcProcess
from tests.system import free_tcp_port
from tests.waiting import until
from ua_fleet.bridge.driver import (
    Execution,
    ExecutionEnded,
    ExecutionFact,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
)
from ua_fleet.config.load import load_content
from ua_fleet.counters import Drop
from ua_fleet.errors import RobotBusy, RobotOffline, SkillRejected, StorageUnavailable
from ua_fleet.values import StatusCode

FACTS = (ExecutionEnded, ExecutionForgotten, ExecutionNotBegun)


class Machine:
    """A PLC with the program `work`, and a driver for it."""

    def __init__(self, folder: Path, cycle: str = "          cycle_s: 0.1\n") -> None:
        port = free_tcp_port()
        self.plc = PlcProcess("--port", str(port))
        content = FLEET.format(port=port).replace(
            "          poll_s: 0.02\n", f"          poll_s: 0.02\n          accept_s: 0.4\n{cycle}"
        )
        self._config, self._folder = load_content(content.encode(), "fleet.yaml", {}), folder
        self.recorder = Recorder()
        self.driver = self._make()

    def _make(self) -> ModbusDriver:
        driver = create_driver(self._config, "plc")
        driver.remember_in(self._folder)
        return driver

    async def restart(self) -> None:
        """Another driver in place of this one."""
        await self.driver.stop()
        self.driver = self._make()
        await self.driver.start(self.recorder)

    def execution(self, work: str, seconds: float = 0.0) -> Execution:
        (skill,) = self.driver.skills()
        return Execution(secrets.token_bytes(16), skill.topic, skill.targets[0].id, (work, seconds), 20.0)

    def begin(self, work: str, seconds: float = 0.0) -> Execution:
        execution = self.execution(work, seconds)
        self.driver.execute(execution)
        return execution

    def word(self, address: int) -> int:
        return int(self.plc.do("cells", table="holding", address=address, count=1)["cells"][0])

    async def at_it(self, execution: Execution) -> None:
        await until(
            lambda: any(self._is_of(event, execution, (ExecutionProgressed,)) for event in self.events()), "work"
        )

    async def end(self, execution: Execution) -> ExecutionFact:
        def ends() -> list[ExecutionFact]:
            return [event for event in self.events() if self._is_of(event, execution, FACTS)]

        await until(ends, "the end")
        return ends()[0]

    def events(self) -> list[ExecutionFact]:
        kinds = (ExecutionProgressed, *FACTS)
        return [event for event in list(self.recorder.events) if isinstance(event, kinds)]

    @staticmethod
    def _is_of(event: ExecutionFact, execution: Execution, kinds: tuple[type, ...]) -> bool:
        return isinstance(event, kinds) and event.execution_id == execution.execution_id


@pytest.fixture
async def machine(tmp_path: Path) -> AsyncGenerator[Machine]:
    made = Machine(tmp_path)
    await made.driver.start(made.recorder)
    try:
        yield made
    finally:
        await made.driver.stop()
        made.plc.end()


@pytest.fixture
async def slow(tmp_path: Path) -> AsyncGenerator[Machine]:
    """A PLC of which nobody says how long it takes from reading to beginning."""
    made = Machine(tmp_path, "")
    await made.driver.start(made.recorder)
    try:
        yield made
    finally:
        await made.driver.stop()
        made.plc.end()


def read_before(machine: Machine, number: int) -> None:
    """The program begins what it has read before it was taken back."""
    machine.plc.do("run", having_read=number)


async def test_whether_a_slow_program_has_read_it_nobody_knows(slow: Machine) -> None:
    slow.plc.do("stop")
    first = slow.begin("never ends")
    told = await slow.end(first)
    assert isinstance(told, ExecutionForgotten)
    assert "did not begin within 0.4 s" in told.message
    assert slow.word(104) == 1  # should it begin it yet, it stops
    second = slow.begin("paint")
    await until(lambda: slow.word(100) == 2, "another number")
    read_before(slow, 1)
    await until(lambda: slow.recorder.dropped(Drop.UNASKED), "that it has begun after all")
    ended = await slow.end(second)
    assert not (isinstance(ended, ExecutionEnded) and ended.status == StatusCode.GOOD)


async def test_what_a_slow_program_begins_while_it_is_watched_is_followed(
    slow: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job, "_LEAST_WATCH_S", 10.0)  # so that it begins meanwhile on a busy machine too
    slow.plc.do("stop")
    execution = slow.begin("weld")
    await until(lambda: slow.word(100) == 1, "the request")
    await until(lambda: slow.word(100) == 0, "the withdrawal")
    read_before(slow, 1)
    assert await slow.end(execution) == ExecutionEnded(execution.execution_id, 0, ("weld", 0.0))
    await asyncio.sleep(0.2)
    assert slow.plc.told == ["weld"]


async def test_withdrawn_number_that_is_begun_later_is_said_and_stopped(slow: Machine) -> None:
    slow.plc.do("stop")
    await slow.end(slow.begin("never ends"))
    slow.plc.do("put", table="holding", address=104, type="uint16", values=[0])
    read_before(slow, 1)
    await until(lambda: slow.recorder.dropped(Drop.UNASKED), "that it has begun after all")
    await until(lambda: slow.word(104) == 1 and not slow.word(102) & 1, "the halt")
    again = slow.begin("paint")
    assert await slow.end(again) == ExecutionEnded(again.execution_id, 0, ("paint", 0.0))
    assert slow.word(101) == 2


async def test_withdrawn_number_is_not_given_after_a_restart(slow: Machine) -> None:
    slow.plc.do("stop")
    await slow.end(slow.begin("weld"))
    await slow.restart()
    second = slow.begin("paint")
    await until(lambda: slow.word(100) == 2, "another number")
    slow.plc.do("run")
    assert await slow.end(second) == ExecutionEnded(second.execution_id, 0, ("paint", 0.0))


async def test_driver_that_was_restarted_while_it_watched_does_not_know_either(slow: Machine) -> None:
    await slow.end(slow.begin("paint"))
    slow.plc.do("stop")
    execution = slow.begin("weld")
    await until(lambda: slow.word(100) == 2, "the request")
    await until(lambda: slow.word(100) == 0, "the withdrawal")
    await slow.restart()
    slow.driver.query(execution)
    assert isinstance(await slow.end(execution), ExecutionForgotten)


async def test_program_that_begins_what_was_taken_back_does_not_begin_the_one_before_again(slow: Machine) -> None:
    await slow.end(slow.begin("paint"))
    slow.plc.do("stop")
    await slow.end(slow.begin("weld"))
    assert slow.word(100) == 0  # and not 1, which the program would do again after 2


async def test_request_that_is_not_begun_is_taken_back_and_never_done(machine: Machine) -> None:
    machine.plc.do("stop")
    ended = await machine.end(machine.begin("weld"))
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == StatusCode.BAD_NO_COMMUNICATION
    assert ended.message == "the device did not begin within 0.4 s; is its program running?"
    assert machine.word(100) == 0
    machine.plc.do("run")
    await asyncio.sleep(0.2)
    assert machine.plc.told == []
    again = machine.begin("paint")
    assert await machine.end(again) == ExecutionEnded(again.execution_id, 0, ("paint", 0.0))
    assert machine.plc.told == ["paint"]


async def test_plc_that_lost_its_memory_cannot_tell(machine: Machine) -> None:
    execution = machine.begin("weld", 10.0)
    await machine.at_it(execution)
    machine.plc.do("clear")
    ended = await machine.end(execution)
    assert isinstance(ended, ExecutionForgotten)
    assert "see what it did" in ended.message
    again = machine.begin("paint")
    assert await machine.end(again) == ExecutionEnded(again.execution_id, 0, ("paint", 0.0))


async def test_plc_with_an_old_memory_cannot_tell_either(machine: Machine) -> None:
    first = machine.begin("weld")
    await machine.end(first)
    execution = machine.begin("paint", 10.0)
    await machine.at_it(execution)
    machine.plc.do("clear")
    machine.plc.do("put", table="holding", address=100, type="uint16", values=[1, 1])
    assert isinstance(await machine.end(execution), ExecutionForgotten)


async def test_restarted_driver_knows_what_was_never_written(machine: Machine) -> None:
    first = machine.begin("weld")
    await machine.end(first)
    await machine.restart()
    unknown = machine.execution("paint")
    machine.driver.query(unknown)
    assert await machine.end(unknown) == ExecutionNotBegun(unknown.execution_id)
    machine.driver.execute(unknown)
    await until(lambda: machine.plc.told == ["weld", "paint"], "the work")


async def test_what_waits_in_a_plc_that_stands_still_is_followed_by_the_next_driver(machine: Machine) -> None:
    machine.plc.do("stop")
    execution = machine.begin("weld")
    await until(lambda: machine.word(100) == 1, "the request")
    await machine.restart()
    machine.plc.do("run")
    machine.driver.query(execution)
    assert await machine.end(execution) == ExecutionEnded(execution.execution_id, 0, ("weld", 0.0))
    assert machine.plc.told == ["weld"]


async def test_record_that_cannot_be_read_is_told_and_keeps_no_other_skill_back(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_: object, execution_id: bytes) -> None:
        raise StorageUnavailable(f"handshakes.db: disk I/O error with {len(execution_id)} bytes; look at the disk")

    done = machine.begin("weld")
    await machine.end(done)
    machine.recorder.events.clear()
    await machine.restart()
    monkeypatch.setattr(HandshakeMemory, "find", broken)
    machine.driver.query(done)
    told = await machine.end(done)
    assert isinstance(told, ExecutionForgotten)
    assert told.message.startswith("the bridge's record of it cannot be read: handshakes.db: disk I/O error")
    again = machine.begin("paint")
    assert await machine.end(again) == ExecutionEnded(again.execution_id, 0, ("paint", 0.0))
    assert machine.recorder.dropped(Drop.MALFORMED) == 0


async def test_one_at_a_time(machine: Machine) -> None:
    machine.begin("weld", 1.0)
    with pytest.raises(RobotBusy, match="machine is busy; its device takes one skill at a time"):
        machine.begin("paint")


async def test_device_that_is_busy_with_something_else_is_left_alone(machine: Machine) -> None:
    machine.plc.do("stop")
    machine.plc.do("put", table="holding", address=102, type="bool", bit=0, values=[True])
    ended = await machine.end(machine.begin("weld"))
    assert isinstance(ended, ExecutionEnded)
    said = (StatusCode.BAD_TOO_MANY_OPERATIONS, "the device is busy with something else")
    assert (ended.status, ended.message) == said
    assert machine.word(100) == 0


async def test_argument_that_does_not_fit_is_refused_before_anything_is_written(machine: Machine) -> None:
    with pytest.raises(SkillRejected, match="the text has 41 bytes; holding 130 to 149 holds 40"):
        machine.begin("x" * 41)
    assert machine.word(100) == 0


async def test_absent_device_is_said_at_once(machine: Machine) -> None:
    machine.plc.do("hang up")
    await until(lambda: not machine.driver.status().connected, "the loss")
    with pytest.raises(RobotOffline, match="machine cannot be reached"):
        machine.begin("weld")


async def test_halt_before_the_beginning_takes_the_request_back(machine: Machine) -> None:
    machine.plc.do("stop")
    execution = machine.begin("weld")
    await until(lambda: machine.word(100) == 1, "the request")
    machine.driver.halt(execution)
    ended = await machine.end(execution)
    assert isinstance(ended, ExecutionEnded)
    assert ended.status == StatusCode.BAD_REQUEST_CANCELLED_BY_CLIENT
    assert machine.word(100) == 0
    assert machine.plc.told == []
