"""Cyclic programs of a simulated PLC that do skills by handshake, as docs/plc.md tells a PLC programmer to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from ua_demo.simulators.modbus.memory import Memory
from ua_fleet.registers import Register, RegisterType, Table

__all__ = ["Conveyor", "HandshakeLayout", "HandshakeProgram", "Refusal", "Task", "Work"]


class Refusal(Exception):
    """The program does not do what it is asked for; the text says why."""


class Task(Protocol):
    """What a skill does, cycle by cycle."""

    def begin(self, memory: Memory, now: float) -> None:
        """Take the arguments and begin; raises Refusal."""
        ...

    def cycle(self, memory: Memory, now: float) -> float:
        """How far it is: 1 when it is done, and the results are there. Raises Refusal where it fails."""
        ...

    def stop(self, memory: Memory, now: float) -> None:
        """Stop."""
        ...


def _word(address: int) -> Register:
    return Register(Table.HOLDING, address, RegisterType.UINT16)


@dataclass(frozen=True, slots=True)
class HandshakeLayout:
    """Holding registers of a handshake, from one base address.

    +0 request, +1 accepted, +2 flags (bit 0 busy, 1 done, 2 error), +3 progress in percent, +4 halt, +5 command;
    +10 to +29 the error's text; the skill's own registers from +30.
    """

    base: int

    @property
    def request(self) -> Register:
        """Number of the execution that is asked for."""
        return _word(self.base)

    @property
    def accepted(self) -> Register:
        """Number of the execution that was begun last."""
        return _word(self.base + 1)

    def flag(self, bit: int) -> Register:
        """0 busy, 1 done, 2 error."""
        return Register(Table.HOLDING, self.base + 2, RegisterType.BOOL, bit)

    @property
    def progress(self) -> Register:
        """In percent."""
        return _word(self.base + 3)

    @property
    def halt(self) -> Register:
        """Number of the execution that is to stop."""
        return _word(self.base + 4)

    @property
    def command(self) -> Register:
        """Which skill is asked for."""
        return _word(self.base + 5)

    @property
    def error_text(self) -> Register:
        """Why it failed."""
        return Register(Table.HOLDING, self.base + 10, RegisterType.STRING, length=20)


BUSY, DONE, ERROR = range(3)


class HandshakeProgram:
    """One handshake and the skills behind it; call `cycle` again and again, as a PLC's task is."""

    def __init__(self, memory: Memory, layout: HandshakeLayout, tasks: dict[int, Task]) -> None:
        """Make a program that is idle.

        Args:
            memory: of the PLC.
            layout: of the handshake.
            tasks: the skill for each command; 0 where none is asked for.
        """
        self._memory, self._layout, self._tasks = memory, layout, tasks
        self._task: Task | None = None

    def cycle(self, now: float) -> None:
        """One cycle of the program; `now` in seconds."""
        memory, layout = self._memory, self._layout
        request, accepted = memory.get(layout.request), memory.get(layout.accepted)
        if self._task is None and request != accepted and request != 0:
            self._begin(int(request), now)
        elif self._task is not None:
            if memory.get(layout.halt) == accepted:
                self._task.stop(memory, now)
                self._end(ERROR, "stopped")
                return
            self._go_on(self._task, now)

    def _begin(self, number: int, now: float) -> None:
        memory, layout = self._memory, self._layout
        task = self._tasks.get(int(memory.get(layout.command)))
        try:
            if task is None:
                raise Refusal("there is no such command")
            task.begin(memory, now)
        except Refusal as refusal:
            self._end(ERROR, str(refusal))
        else:
            self._task = task
            self._flags(busy=True)
            memory.put(layout.progress, 0)
        memory.put(layout.accepted, number)  # last: when it changes, the rest is there

    def _go_on(self, task: Task, now: float) -> None:
        memory = self._memory
        try:
            progress = task.cycle(memory, now)
        except Refusal as failed:
            self._end(ERROR, str(failed))
            return
        memory.put(self._layout.progress, round(100 * min(progress, 1.0)))
        if progress >= 1:
            self._end(DONE, "")

    def _end(self, flag: int, text: str) -> None:
        self._task = None
        self._memory.put(self._layout.error_text, text[:40])
        self._flags(done=flag == DONE, error=flag == ERROR)

    def _flags(self, *, busy: bool = False, done: bool = False, error: bool = False) -> None:
        for bit, value in ((BUSY, busy), (DONE, done), (ERROR, error)):
            self._memory.put(self._layout.flag(bit), value)


REFUSED_WORK: Final = "refuse"
FAILING_WORK: Final = "fail"
ENDLESS_WORK: Final = "never ends"


class Work:
    """A skill for tests: takes a text and seconds, goes on for so long, and gives both back.

    +30 to +49 the work, +50 the seconds (float64); results +60 to +79, +80.
    """

    def __init__(self, base: int, told: Callable[[str], None]) -> None:
        """`told` is told each work that is begun."""
        self._told = told
        self._work = Register(Table.HOLDING, base + 30, RegisterType.STRING, length=20)
        self._seconds = Register(Table.HOLDING, base + 50, RegisterType.FLOAT64)
        self._result = Register(Table.HOLDING, base + 60, RegisterType.STRING, length=20)
        self._result_seconds = Register(Table.HOLDING, base + 80, RegisterType.FLOAT64)
        self._what, self._from, self._for_s = "", 0.0, 0.0

    def begin(self, memory: Memory, now: float) -> None:
        """See Task."""
        self._what, self._for_s = str(memory.get(self._work)), float(memory.get(self._seconds))
        if self._what == REFUSED_WORK:
            raise Refusal("the machine does not do that")
        self._from = now
        self._told(self._what)

    def cycle(self, memory: Memory, now: float) -> float:
        """See Task."""
        if self._what == ENDLESS_WORK:
            return 0.5
        if self._what == FAILING_WORK:
            raise Refusal("the machine broke")
        if now - self._from < self._for_s:
            return (now - self._from) / self._for_s
        memory.put(self._result, self._what)
        memory.put(self._result_seconds, self._for_s)
        return 1.0

    def stop(self, memory: Memory, now: float) -> None:
        """See Task. There is nothing that moves."""


class Conveyor:
    """A belt: moves by a distance at a speed.

    Holding +30 the distance in mm (int32), +32 the speed in mm/s (uint16); result +34 the distance that was moved
    (int32). Input registers 0 the position in mm (int32), 2 the speed now (uint16); discrete input 0: the belt runs.
    """

    FASTEST_MM_S: Final = 1000

    def __init__(self, base: int, told: Callable[[str], None]) -> None:
        """Make a belt at position 0 whose registers begin at `base`; `told` is told each move that is begun."""
        self._told = told
        self._distance = Register(Table.HOLDING, base + 30, RegisterType.INT32)
        self._speed = Register(Table.HOLDING, base + 32, RegisterType.UINT16)
        self._moved = Register(Table.HOLDING, base + 34, RegisterType.INT32)
        self._position = Register(Table.INPUT, 0, RegisterType.INT32)
        self._speed_now = Register(Table.INPUT, 2, RegisterType.UINT16)
        self._runs = Register(Table.DISCRETE, 0, RegisterType.BOOL)
        self._began = self._begin_mm = self._way_mm = self._mm_s = 0.0

    def begin(self, memory: Memory, now: float) -> None:
        """See Task."""
        self._way_mm, self._mm_s = float(memory.get(self._distance)), float(memory.get(self._speed))
        if not 0 < self._mm_s <= self.FASTEST_MM_S:
            raise Refusal(f"speed is 1 to {self.FASTEST_MM_S} mm/s")
        self._began, self._begin_mm = now, float(memory.get(self._position))
        self._told(f"move by {self._way_mm:.0f} mm")
        memory.put(self._runs, True)
        memory.put(self._speed_now, round(self._mm_s))

    def cycle(self, memory: Memory, now: float) -> float:
        """See Task."""
        way = abs(self._way_mm)
        moved = min((now - self._began) * self._mm_s, way)
        signed = moved if self._way_mm >= 0 else -moved
        memory.put(self._position, round(self._begin_mm + signed))
        memory.put(self._moved, round(signed))
        if moved >= way:
            self.stop(memory, now)
            return 1.0
        return moved / way

    def stop(self, memory: Memory, now: float) -> None:
        """See Task: the belt stands at once."""
        memory.put(self._runs, False)
        memory.put(self._speed_now, 0)
