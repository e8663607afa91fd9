"""The memory of a simulated PLC: four tables, and values in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from ua_fleet.registers import Cell, Register, RegisterType, Span, Table, decode, encode

__all__ = ["Memory"]

SIZE: Final = 10_000


class Memory:
    """All addresses from 0 to `size` - 1 of each table. Used in one thread."""

    def __init__(self, size: int = SIZE) -> None:
        """Make one that is all zero."""
        self.size = size
        self._tables: dict[Table, list[Cell]] = {
            table: [False] * size if table.is_bits else [0] * size for table in Table
        }
        self.on_read: Callable[[Span], None] = lambda span: None
        """Told what a client has read."""
        self.on_write: Callable[[Span], None] = lambda span: None
        """Told what a client has written."""

    def has(self, span: Span) -> bool:
        """Whether all the addresses exist."""
        return span.end <= self.size

    def cells(self, span: Span) -> list[Cell]:
        """What lies there."""
        return self._tables[span.table][span.address : span.end]

    def put_cells(self, span: Span, cells: Sequence[Cell]) -> None:
        """Lay something there."""
        self._tables[span.table][span.address : span.end] = cells

    def get(self, register: Register) -> bool | int | float | str:
        """The value of a register."""
        return decode(register, self.cells(register.span))

    def put(self, register: Register, value: bool | float | str) -> None:
        """Give a register a value. Of a word with bits only the one is changed."""
        cells = encode(register, value)
        if register.type is RegisterType.BOOL and not register.table.is_bits:
            (mask,), (word,) = encode(register, True), self.cells(register.span)
            cells = ((int(word) & ~int(mask)) | int(cells[0]),)
        self.put_cells(register.span, cells)
