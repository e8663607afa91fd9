"""A PLC's commands, one after the other: each number is done once, whatever is repeated, lost or restarted.

    the PLC writes a new number      recorded as ASKING, then the fleet is asked
    the fleet has begun it           recorded as RUNNING with its id; from now on it is only followed
    it has ended                     recorded, and shown: the state last
    the same number again            nothing: the answer stands there already
    another one while one runs       waits until that has ended
    it cannot be recorded            refused, or shown as it is; recorded as soon as the disk takes it

After a restart a RUNNING one is followed again by its id; an ASKING one is UNKNOWN, since the fleet may have begun it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from ua_fleet.config.base import ScalarType
from ua_fleet.errors import StorageUnavailable
from ua_fleet.modbus.image import Image
from ua_fleet.modbus.memory import CommandMemory, LastCommand
from ua_fleet.modbus.table import ArgumentRegisters, Command
from ua_fleet.modbus.words import CommandState, control, status
from ua_fleet.registers import AddressSpan, RegisterUnfit, cast
from ua_fleet.values import StatusCode

__all__ = ["CommandDesk", "PendingCommand"]

_MOST_BYTES = 40
"""Of the message that a PLC can read."""


def _readable(text: str) -> str:
    """Text from anywhere, as the message can show it."""
    printable = "".join(character if character.isprintable() else " " for character in text)
    return printable.encode()[:_MOST_BYTES].decode(errors="ignore")


class PendingCommand(NamedTuple):
    """A command that is to be begun."""

    command: Command
    arguments: dict[str, Any]


class CommandDesk:
    """The command words and the answer words."""

    def __init__(
        self, image: Image, memory: CommandMemory, commands: Mapping[int, Command], control_base: int, status_base: int
    ) -> None:
        """Show what is remembered."""
        self._image, self._memory, self._commands = image, memory, commands
        self._command, self._code = control("command", control_base), control("code", control_base)
        self._status_base = status_base
        self.last = memory.last() or LastCommand(0, 0, CommandState.NONE)
        self._asked: PendingCommand | None = None
        self._is_unrecorded = False
        """Whether the disk has not taken yet what `last` has."""
        if self.last.state is CommandState.ASKING:
            self.end(CommandState.UNKNOWN, StatusCode.UNCERTAIN, "restarted while it was asked for; look at the robot")
        image.put(self._command, self.last.number)
        self._show()

    def written(self, span: AddressSpan) -> None:
        """A PLC has written; perhaps a command."""
        if span.overlaps(self._command.span):
            self.look()

    def look(self) -> None:
        """Take the command that stands there, where there is a new one and none runs."""
        number = int(self._image.get(self._command))
        if number in (0, self.last.number) or not (self.last.state.is_over or self.last.state is CommandState.NONE):
            return
        code = int(self._image.get(self._code))
        asking = LastCommand(number, code, CommandState.ASKING)
        try:
            self._memory.record(asking)
        except StorageUnavailable as error:
            self._refuse_unrecorded(asking, error)
            return
        self.last, self._is_unrecorded = asking, False
        self._take(code)
        self._show()

    def take(self) -> PendingCommand | None:
        """The command that is to be begun; once."""
        asked, self._asked = self._asked, None
        return asked

    def began(self, begun: str) -> None:
        """The fleet has begun it."""
        self._record(self.last._replace(state=CommandState.RUNNING, begun=begun))

    def progress(self, fraction: float) -> None:
        """How far it is, 0 to 1."""
        percent = round(100 * min(max(0.0, fraction), 1.0))  # in this order a NaN counts as 0
        self._image.put(status("progress", self._status_base), percent)

    def end(self, state: CommandState, code: int, message: str, results: Mapping[str, Any] | None = None) -> None:
        """It is over; where it was not begun the state says so."""
        text = json.dumps(results or {})
        self._record(self.last._replace(state=state, status=int(code), message=_readable(message), results=text))
        self.look()

    def record_again(self) -> None:
        """Record what the disk did not take: at the next start the PLC's words would begin a refused command."""
        if not self._is_unrecorded:
            return
        try:
            self._memory.record(self.last)
        except StorageUnavailable:
            return  # the PLC reads it as the message
        self._is_unrecorded = False

    def _take(self, code: int) -> None:
        command = self._commands.get(code)
        if command is None:
            self.end(CommandState.REFUSED, StatusCode.BAD_NOT_FOUND, f"there is no command {code}")
            return
        try:
            arguments = {argument.name: self._value(argument) for argument in command.arguments}
        except RegisterUnfit as unfit:
            self.end(CommandState.REFUSED, unfit.status, unfit.reason)
            return
        self._asked = PendingCommand(command, arguments)

    def _value(self, argument: ArgumentRegisters) -> Any:
        return cast(self._image.get(argument.register), argument.type.builtin)

    def _record(self, command: LastCommand) -> None:
        self.last = command
        try:
            self._memory.record(command)
        except StorageUnavailable as error:
            # It is shown all the same; after a restart it would be taken for what was recorded before, and followed.
            self.last, self._is_unrecorded = command._replace(message=str(error)), True
        else:
            self._is_unrecorded = False
        self._show()

    def _refuse_unrecorded(self, asking: LastCommand, error: StorageUnavailable) -> None:
        """Nothing is begun that cannot be remembered."""
        self.last = asking._replace(state=CommandState.REFUSED, status=int(error.ua_status), message=str(error))
        self._is_unrecorded = True
        self._show()

    def _show(self) -> None:
        last, base, put = self.last, self._status_base, self._image.put
        put(status("status", base), last.status)
        put(status("message", base), _readable(last.message))
        if last.state is CommandState.DONE:
            self.progress(1.0)
            self._show_results(last)
        elif last.state is not CommandState.RUNNING:
            self.progress(0.0)
        put(status("answer", base), last.number)
        put(status("state", base), last.state)

    def _show_results(self, last: LastCommand) -> None:
        command = self._commands.get(last.code)
        results: dict[str, Any] = json.loads(last.results or "{}")
        for result in command.results if command is not None else ():
            value = results.get(result.name)
            if value is not None:
                self._put_result(result, value)

    def _put_result(self, result: ArgumentRegisters, value: Any) -> None:
        try:
            self._image.put(result.register, bool(value) if result.type is ScalarType.BOOLEAN else value)
        except RegisterUnfit as unfit:
            self._image.put(status("message", self._status_base), _readable(f"{result.name}: {unfit.reason}"))
            self._image.put(status("status", self._status_base), int(unfit.status))
