"""The connection to the OPC UA server drops in the middle: what was asked for is refused or unknown, and never late.

A client that fails at a given moment stands in for the network, which does so at any.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from tests.waiting import until
from ua_fleet.client import DecisionInfo, FleetClient, NodeInfo, ScenarioClient
from ua_fleet.client.fleet_client import Reading
from ua_fleet.config.load import load_content
from ua_fleet.errors import NotConnected, SendTimeout, StorageUnavailable
from ua_fleet.modbus import gateway as module
from ua_fleet.modbus.gateway import Gateway
from ua_fleet.modbus.memory import CommandMemory
from ua_fleet.modbus.words import CommandState, DecisionOutcome, control, status
from ua_fleet.registers import AddressSpan, Register, RegisterType, Table

GOAL = Register(Table.HOLDING, 10, RegisterType.INT16)
FLEET = b"""\
version: 1
pubsub: {security: none}
bridges: {cell: {kind: ros1, status_id: 1}}
robots:
  arm:
    bridge: cell
    skill_status_id: 2
    data:
      goal: {id: 5, type: Double, origin: server}
    skills:
      turn: {id: 6}
modbus:
  robots: [arm]
  sets: {arm.goal: {table: holding, address: 10, type: int16}}
  commands:
    turn: {code: 1, robot: arm, skill: turn}
"""


class Line:
    """A client whose connection drops when it is told to, and comes back when it is told to."""

    endpoint = "opc.tcp://nowhere"

    def __init__(self) -> None:
        self.is_up = True
        self.dropped = asyncio.Event()
        self.asked: list[str] = []
        self.on_write: Callable[[], None] = self.check
        self.is_slow_to_start = False

    def drop(self) -> None:
        self.is_up = False
        self.dropped.set()
        self.check()

    def check(self) -> None:
        if not self.is_up:
            raise NotConnected("the connection was lost")

    @asynccontextmanager
    async def connect(self) -> AsyncGenerator[FleetClient]:
        self.check()
        self.dropped.clear()
        yield cast("FleetClient", self)

    async def watch(self, _addresses: Sequence[str]) -> AsyncGenerator[Any]:
        await self.dropped.wait()
        self.check()
        yield

    async def write(self, _address: str, text: str) -> None:
        self.asked.append(text)
        self.on_write()

    async def start_skill(self, robot: str, skill: str, /, **_: Any) -> Any:
        self.asked.append(f"{robot}.{skill}")
        if self.is_slow_to_start:
            await asyncio.sleep(60)
        raise NotConnected("the connection was lost")

    async def read(self, _addresses: Sequence[str]) -> list[Reading]:
        return []

    async def browse(self, _address: str) -> list[NodeInfo]:
        return []


class Working:
    """A gateway at work on that line."""

    def __init__(self, folder: Path) -> None:
        self.line = Line()
        self.memory = CommandMemory(folder / "commands.db")
        self.gateway = Gateway(load_content(FLEET, "F", {}), self.memory)

    def write(self, *values: tuple[Register, int]) -> None:
        for register, value in values:
            self.gateway.image.put(register, value)
        self.gateway.written(AddressSpan(Table.HOLDING, 0, 11))

    def word(self, name: str) -> int:
        return int(self.gateway.image.get(status(name, 0)))

    async def ended(self, number: int) -> CommandState:
        await until(lambda: self.word("answer") == number and CommandState(self.word("state")).is_over, "the end")
        return CommandState(self.word("state"))

    @asynccontextmanager
    async def work(self) -> AsyncGenerator[Working]:
        work = asyncio.create_task(self.gateway.run(self.line.connect))
        try:
            await until(lambda: self.word("connected") == 1, "the connection")
            yield self
            assert not work.done()
        finally:
            work.cancel()
            await asyncio.gather(work, return_exceptions=True)
            self.memory.close()


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RETRY_S", (0.3, 0.3))


def command(number: int) -> tuple[tuple[Register, int], tuple[Register, int]]:
    return (control("code", 0), 1), (control("command", 0), number)


async def test_command_that_waits_when_the_connection_drops_is_refused(tmp_path: Path) -> None:
    async with Working(tmp_path).work() as working:
        working.line.on_write = working.line.drop
        working.write((GOAL, 7), *command(1))
        assert await working.ended(1) is CommandState.REFUSED
        assert working.word("connected") == 0
        working.line.is_up, working.line.on_write = True, working.line.check
        await until(lambda: working.word("connected") == 1, "the connection again")
        await asyncio.sleep(0.3)
        assert working.line.asked == ["7"], "neither the value nor the command comes late"


async def test_command_that_is_asked_for_when_the_connection_drops_is_unknown(tmp_path: Path) -> None:
    async with Working(tmp_path).work() as working:
        working.line.is_slow_to_start = True
        working.write(*command(1))
        await until(lambda: "arm.turn" in working.line.asked, "the request")
        working.line.is_up = False
        working.line.dropped.set()
        assert await working.ended(1) is CommandState.UNKNOWN
        working.write(*command(2))
        assert await working.ended(2) is CommandState.REFUSED


async def test_command_that_a_full_disk_refused_is_recorded_once_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise StorageUnavailable("the disk is full; free some space")

    async with Working(tmp_path).work() as working:
        with monkeypatch.context() as on_full_disk:
            on_full_disk.setattr(working.memory, "record", full)
            working.write(*command(1))
            assert await working.ended(1) is CommandState.REFUSED
        await until(lambda: working.memory.last() is not None, "the record")
    memory = CommandMemory(tmp_path / "commands.db")
    last = memory.last()
    memory.close()
    assert last is not None
    assert (last.number, last.state) == (1, CommandState.REFUSED)


@pytest.mark.parametrize("error", [NotConnected, SendTimeout, None], ids=["lost", "no answer", "seen elsewhere first"])
async def test_choice_whose_answer_is_lost_is_unknown_and_can_be_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[NotConnected | SendTimeout] | None
) -> None:
    """The server has not taken it; the PLC writes its words in each cycle."""
    decision = DecisionInfo("d", "open", "turn", "arm", "silent", "", "", ("arm",), (0.5,), (), (), 0.0)
    asked: list[str] = []
    working = Working(tmp_path)

    async def decisions(_: Any) -> list[DecisionInfo]:
        return [] if len(asked) == 2 else [decision]

    async def confirm(_: Any, _decision_id: str, robot: str) -> str:
        asked.append(robot)
        if len(asked) == 1:
            working.line.is_up = False
            working.line.dropped.set()
            if error is not None:
                raise error("nothing came back")
            await asyncio.sleep(60)
        return "taken"

    monkeypatch.setattr(ScenarioClient, "decisions", decisions)
    monkeypatch.setattr(ScenarioClient, "confirm", confirm)
    async with working.work():
        choice = ((control("chosen", 0), 1), (control("decision", 0), 1))

        def outcome() -> tuple[int, int]:
            working.write(*choice)
            return working.word("decided"), working.word("outcome")

        await until(lambda: working.word("decision") == 1, "the decision")
        await until(lambda: outcome() == (1, DecisionOutcome.UNKNOWN), "that nobody knows")
        await until(lambda: working.word("connected") == 0, "that it is away")
        await asyncio.sleep(2 * module.POLL_S)
        assert outcome() == (1, DecisionOutcome.UNKNOWN), "it is not refused while the server is away"
        working.line.is_up = True
        await until(lambda: outcome() == (1, DecisionOutcome.TAKEN), "that it was taken")
    assert asked == ["arm", "arm"]
