"""A PLC's commands: each number once, whatever is repeated or restarted."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.config import modbus_checks
from ua_fleet.config.base import ScalarType
from ua_fleet.config.modbus_schema import CommandConfig
from ua_fleet.errors import StorageUnavailable
from ua_fleet.modbus.commands import CommandDesk
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.memory import CommandMemory, LastCommand
from ua_fleet.modbus.table import ArgumentRegisters, Command
from ua_fleet.modbus.words import CONTROL, STATUS, CommandState, control, status
from ua_fleet.registers import Register, RegisterType, Table
from ua_fleet.values import StatusCode

ANGLE = Register(Table.HOLDING, 20, RegisterType.INT16, scale=0.1)
REACHED = Register(Table.INPUT, 60, RegisterType.INT16, scale=0.1)
TURN = Command(
    "turn",
    CommandConfig(code=7, robot="arm", skill="turn"),
    (ArgumentRegisters("angle", ANGLE, ScalarType.DOUBLE),),
    (ArgumentRegisters("reached", REACHED, ScalarType.DOUBLE),),
)


class Device:
    """The command words over one or several lives of the process."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "commands.db"
        self.start()

    def start(self) -> None:
        self.memory = CommandMemory(self._path)
        words = [control(word.name, 0) for word in CONTROL]
        self.image = Image([*(status(word.name, 0) for word in STATUS), REACHED], [*words, ANGLE])
        self.desk = CommandDesk(self.image, self.memory, {7: TURN}, 0, 0)

    def restart(self) -> None:
        self.memory.close()
        self.start()

    @contextmanager
    def full_disk(self) -> Generator[None]:
        """Nothing is recorded within."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(self.memory, "record", full)
            yield

    def write(self, register: Register, value: Any) -> None:
        self.image.put(register, value)
        self.desk.written(register.span)

    def command(self, number: int, code: int = 7, angle: float = 1.5) -> None:
        self.write(ANGLE, angle)
        self.write(control("code", 0), code)
        self.write(control("command", 0), number)

    def answer(self) -> tuple[int, CommandState]:
        number, state = (int(self.image.get(status(name, 0))) for name in ("answer", "state"))
        return number, CommandState(state)

    def message(self) -> str:
        return str(self.image.get(status("message", 0)))


@pytest.fixture
def device(tmp_path: Path) -> Device:
    return Device(tmp_path)


def test_a_command_is_taken_once_with_its_arguments(device: Device) -> None:
    assert device.answer() == (0, CommandState.NONE)
    device.command(5)
    assert device.answer() == (5, CommandState.ASKING)
    asked = device.desk.take()
    assert asked is not None
    assert (asked.command.name, asked.arguments) == ("turn", {"angle": 1.5})
    device.write(control("command", 0), 5)
    assert device.desk.take() is None
    device.desk.began("abc")
    assert device.answer() == (5, CommandState.RUNNING)
    device.desk.progress(0.5)
    assert device.image.get(status("progress", 0)) == 50
    device.desk.end(CommandState.DONE, 0, "", {"reached": 1.4})
    assert device.answer() == (5, CommandState.DONE)
    assert device.image.get(REACHED) == 1.4
    device.write(control("command", 0), 5)
    assert device.desk.take() is None


def test_the_next_one_waits_until_the_last_is_over(device: Device) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    device.command(2, angle=2.5)
    assert device.desk.take() is None
    assert device.answer() == (1, CommandState.RUNNING)
    device.desk.end(CommandState.FAILED, StatusCode.BAD_UNEXPECTED_ERROR, "it broke")
    asked = device.desk.take()
    assert asked is not None
    assert asked.arguments == {"angle": 2.5}
    assert device.answer() == (2, CommandState.ASKING)


def test_what_runs_is_followed_after_a_restart(device: Device) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    device.restart()
    assert device.desk.take() is None
    assert device.desk.last == LastCommand(1, 7, CommandState.RUNNING, "abc")
    assert device.answer() == (1, CommandState.RUNNING)
    device.command(1)
    assert device.desk.take() is None


def test_what_may_have_been_begun_is_unknown_after_a_restart_and_not_begun_again(device: Device) -> None:
    device.command(1)
    device.restart()
    assert device.answer() == (1, CommandState.UNKNOWN)
    device.command(1)
    assert device.desk.take() is None
    device.command(2)
    assert device.desk.take() is not None


def test_results_are_there_after_a_restart(device: Device) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    device.desk.end(CommandState.DONE, 0, "", {"reached": -0.5})
    device.restart()
    assert device.answer() == (1, CommandState.DONE)
    assert device.image.get(REACHED) == -0.5


def test_unknown_code_is_refused_and_the_next_number_is_taken(device: Device) -> None:
    device.command(1, code=99)
    assert device.answer() == (1, CommandState.REFUSED)
    assert device.image.get(status("status", 0)) == StatusCode.BAD_NOT_FOUND
    assert device.message() == "there is no command 99"
    device.command(2)
    assert device.desk.take() is not None


def test_result_that_does_not_fit_is_said(device: Device) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    device.desk.end(CommandState.DONE, 0, "", {"reached": 1e9})
    assert device.answer() == (1, CommandState.DONE)
    assert device.image.get(status("status", 0)) == StatusCode.BAD_OUT_OF_RANGE
    assert device.message().startswith("reached: 1000000000")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\0b\nc", "a b c"),
        ("half a character: \ud800", "half a character:  "),
        ("thirty-nine characters, and then a half: \u00fc", "thirty-nine characters, and then a half:"),
    ],
)
def test_any_text_of_a_robot_is_shown_also_after_a_restart(device: Device, text: str, shown: str) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    device.desk.end(CommandState.FAILED, StatusCode.BAD_UNEXPECTED_ERROR, text)
    for _ in range(2):
        assert device.answer() == (1, CommandState.FAILED)
        assert device.message() == shown
        device.restart()


def test_text_that_was_recorded_before_it_could_be_shown_is_shown(device: Device) -> None:
    device.memory.record(LastCommand(1, 7, CommandState.FAILED, "abc", StatusCode.BAD_UNEXPECTED_ERROR, "a\0b"))
    device.restart()
    assert device.answer() == (1, CommandState.FAILED)
    assert device.message() == "a b"


@pytest.mark.parametrize(
    ("fraction", "percent"), [(math.nan, 0), (-1.0, 0), (0.504, 50), (7.0, 100), (math.inf, 100), (-math.inf, 0)]
)
def test_any_progress_of_a_robot_is_shown(device: Device, fraction: float, percent: int) -> None:
    device.command(1)
    device.desk.progress(fraction)
    assert device.image.get(status("progress", 0)) == percent


@pytest.mark.parametrize("reached", [[1.0], {"at": 1.0}, "far", 10**400], ids=["array", "object", "text", "huge"])
def test_result_that_is_no_value_of_its_type_is_said(device: Device, reached: Any) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    device.desk.end(CommandState.DONE, 0, "", {"reached": reached})
    assert device.answer() == (1, CommandState.DONE)
    assert device.message().startswith("reached: ")


def full(*_: object) -> None:
    raise StorageUnavailable("the disk is full; free some space")


def test_nothing_is_begun_that_cannot_be_remembered(device: Device) -> None:
    with device.full_disk():
        device.command(1)
        assert device.desk.take() is None
    assert device.answer() == (1, CommandState.REFUSED)
    assert device.message() == "the disk is full; free some space"


def test_command_refused_for_a_full_disk_is_not_begun_by_the_same_words_after_a_restart(device: Device) -> None:
    with device.full_disk():
        device.command(1)
        device.desk.record_again()
        assert device.memory.last() is None
    device.desk.record_again()
    device.restart()
    device.command(1)
    assert device.desk.take() is None
    assert device.answer() == (1, CommandState.REFUSED)
    device.command(2)
    assert device.desk.take() is not None


def test_end_that_the_disk_did_not_take_is_there_after_a_restart(
    device: Device,
) -> None:
    device.command(1)
    device.desk.take()
    device.desk.began("abc")
    with device.full_disk():
        device.desk.end(CommandState.DONE, 0, "", {"reached": 1.4})
    device.desk.record_again()
    device.restart()
    assert device.answer() == (1, CommandState.DONE)
    assert device.image.get(REACHED) == 1.4


def test_what_the_disk_did_not_take_of_one_command_is_not_recorded_over_the_next(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    with device.full_disk():
        device.command(1)
    device.command(2)
    recorded: list[LastCommand] = []
    monkeypatch.setattr(device.memory, "record", recorded.append)
    device.desk.record_again()
    assert recorded == []
    assert device.desk.last == LastCommand(2, 7, CommandState.ASKING) == device.memory.last()


def test_lengths_of_the_blocks_are_those_that_the_check_knows() -> None:
    for words, length in ((CONTROL, modbus_checks.CONTROL_WORDS), (STATUS, modbus_checks.STATUS_WORDS)):
        registers = [word.at(Table.INPUT, 0) for word in words]
        assert max(register.span.end for register in registers) == length
        addresses = [address for r in registers for address in range(r.address, r.span.end)]
        assert len(addresses) == len(set(addresses)), "no two words overlap"
