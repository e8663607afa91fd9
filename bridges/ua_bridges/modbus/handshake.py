"""A skill by handshake with a device's program: what its words say of one execution. Pure.

    the bridge writes                       the program (the PLC) writes
    arguments, command
    request := n                            takes the arguments, clears done and error, sets busy,
                                            then accepted := n
                                            results, then done or error, and clears busy
    halt := n                               stops execution n, and ends it with error
    request := 0                            nothing: what it has not read yet is taken back

`n` goes from 1 to 65535 and around, never 0, and is never the number before, nor one that was taken back: a program may
have read that, and begin it yet. It is recorded (`memory.py`) before it is written, or taken back. So after any restart
of the bridge the two words tell what became of an execution:

    request, accepted                       it
    accepted = n                            was begun: busy, done and error are about it
    request = n, accepted another           was written and not begun yet
    request = the number before n           was never written; not so where that is 0, as it is in a cleared memory
    anything else                           the program lost it, or somebody else writes the request: not known
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from enum import Enum
from typing import Any, Final, NamedTuple

from ua_bridges.modbus.config import DeviceConfig, HandshakeSkill
from ua_bridges.modbus.sinks import BitWrite, Writing, writes_of
from ua_bridges.modbus.sources import ReadPlan
from ua_fleet.bridge.configured import ConfiguredSkill
from ua_fleet.config.base import ScalarType
from ua_fleet.config.register_schema import RegisterConfig
from ua_fleet.registers import AddressSpan, Cell, Register, RegisterUnfit, cast, decode

__all__ = ["Phase", "SkillRegisters", "StatusWords", "next_number", "phase_of"]

LAST_NUMBER: Final = 0xFFFF


class StatusWords(NamedTuple):
    """What the program says."""

    request: int
    accepted: int
    busy: bool = False
    done: bool = False
    error: bool = False


class Phase(Enum):
    """How far an execution is, as its device's words say."""

    NEVER_WRITTEN = "never written"
    WAITING = "waiting"
    """Written, and not begun."""
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    LOST = "lost"
    """The words are about another one: nobody can tell."""


def next_number(words: StatusWords, last: int | None = None, withdrawn: Collection[int] = ()) -> int:
    """The number of a new execution: another one than any that the device shows, or may still begin.

    Args:
        words: what the device shows.
        last: the number that it was given last; None where nobody remembers it.
        withdrawn: numbers that were taken back, and that it may have read before.
    """
    number = words.request if last is None else last
    while True:
        number = number % LAST_NUMBER + 1
        if number not in (words.request, words.accepted) and number not in withdrawn:
            return number


def phase_of(words: StatusWords, number: int, before: int) -> Phase:
    """How far the execution with a number is.

    Args:
        words: read at once, or the flags after `accepted`.
        number: of the execution.
        before: the request's word when the number was chosen.
    """
    if words.accepted == number:
        if words.error:
            return Phase.FAILED
        return Phase.DONE if words.done and not words.busy else Phase.RUNNING
    if words.request == number:
        return Phase.WAITING
    return Phase.NEVER_WRITTEN if words.request == before != 0 else Phase.LOST


class SkillRegisters:
    """The registers of one skill, as the device has them."""

    def __init__(self, skill: ConfiguredSkill[HandshakeSkill], device: DeviceConfig) -> None:
        """`skill.via` was checked with the configuration."""
        via = skill.via
        assert via is not None
        self.skill, self.via, self._device = skill, via, device
        self.request = self._of(via.request, ScalarType.UINT16)
        self._accepted = self._of(via.accepted, ScalarType.UINT16)
        self._flags = tuple([self._of(flag, ScalarType.BOOLEAN) for flag in (via.busy, via.done, via.error)])
        self.halt = self._optional(via.halt, ScalarType.UINT16)
        self._command = self._optional(via.command, ScalarType.INT64)
        self._progress = self._optional(via.progress, ScalarType.DOUBLE)
        self._error_text = self._optional(via.error_text, ScalarType.STRING)
        self._error_code = self._optional(via.error_code, ScalarType.INT64)
        config, limits = skill.config, device.limits
        self._arguments = [self._of(via.arguments[name], a.type) for name, a in config.arguments.items()]
        self._results = [(self._of(via.results[name], r.type), r.type.builtin) for name, r in config.results.items()]
        words = [self.request.span, self._accepted.span]
        flags = [flag.span for flag in self._flags]
        self.first = ReadPlan([*words, *flags], limits)
        """Words and flags; where one request brings all, they are of one moment."""
        self.then: ReadPlan | None = None
        """The flags again: read after `accepted`, they are not those of the execution before."""
        if len(self.first.requests) > 1:
            self.first, self.then = ReadPlan(words, limits), ReadPlan(flags, limits)
        extra = [register.span for register in (self._progress,) if register is not None]
        self.while_running = ReadPlan(extra, limits)
        errors = [register.span for register in (self._error_text, self._error_code) if register is not None]
        self.after_error = ReadPlan(errors, limits)
        self.after_done = ReadPlan([register.span for register, _ in self._results], limits)

    def _of(self, register: RegisterConfig, field: ScalarType) -> Register:
        return register.register(self._device.order, field)

    def _optional(self, register: RegisterConfig | None, field: ScalarType) -> Register | None:
        return None if register is None else self._of(register, field)

    def writes(self, values: Sequence[Any]) -> list[Writing | BitWrite]:
        """The writes of arguments and command, without the request; raises RegisterUnfit."""
        pairs = list(zip(self._arguments, values, strict=True))
        if self._command is not None:
            pairs.append((self._command, self.via.code))
        return writes_of(pairs, self._device.write_words, self._device.write_bits)

    def status(self, cells: Mapping[AddressSpan, Sequence[Cell]]) -> StatusWords:
        """What was read by `first`, and by `then` where it is needed."""
        words = [int(_value(register, cells)) for register in (self.request, self._accepted)]
        there = self.then is None or any(request in cells for request in self.then.requests)
        flags = [bool(_value(flag, cells)) for flag in self._flags] if there else [False] * 3
        return StatusWords(words[0], words[1], *flags)

    def progress(self, cells: Mapping[AddressSpan, Sequence[Cell]]) -> float:
        """How far it is, 0 to 1; 0 where nothing says it."""
        if self._progress is None:
            return 0.0
        number = float(_value(self._progress, cells))
        return min(max(number, 0.0), 1.0) if number == number else 0.0

    def error(self, cells: Mapping[AddressSpan, Sequence[Cell]]) -> str:
        """Why it failed, in a line."""
        text = ""
        if self._error_text is not None:
            try:
                text = str(_value(self._error_text, cells)).strip()
            except RegisterUnfit as unfit:
                text = unfit.reason
        if self._error_code is not None and not text:
            text = f"the device says error {_value(self._error_code, cells)}"
        return text or "the device says that it failed"

    def results(self, cells: Mapping[AddressSpan, Sequence[Cell]]) -> tuple[Any, ...]:
        """The results; raises RegisterUnfit where one does not fit its type."""
        return tuple([cast(_value(register, cells), kind) for register, kind in self._results])


def _value(register: Register, cells: Mapping[AddressSpan, Sequence[Cell]]) -> Any:
    span = register.span
    for request, content in cells.items():
        if request.table is span.table and request.address <= span.address and span.end <= request.end:
            begin = span.address - request.address
            return decode(register, content[begin : begin + span.count])
    raise LookupError(f"{span.text} was not read")
