"""The four tables of a device that is shown to others, and the values in them. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from ua_fleet.registers.convert import Cell, decode, encode
from ua_fleet.registers.model import AddressSpan, Register, RegisterType, Table

__all__ = ["TABLE_OF_FUNCTION", "Tables"]

TABLE_OF_FUNCTION: Final[Mapping[int, Table]] = {
    1: Table.COIL,
    2: Table.DISCRETE,
    3: Table.HOLDING,
    4: Table.INPUT,
    5: Table.COIL,
    6: Table.HOLDING,
    15: Table.COIL,
    16: Table.HOLDING,
    22: Table.HOLDING,
    23: Table.HOLDING,
}
"""Which table each function is about (MODBUS Application Protocol 1.1b3, 6)."""


class Tables:
    """Addresses from 0 on. Used in one thread."""

    def __init__(self, sizes: Mapping[Table, int]) -> None:
        """Make tables of zeros."""
        self._cells: dict[Table, list[Cell]] = {
            table: [False] * size if table.is_bits else [0] * size for table, size in sizes.items()
        }

    def has(self, span: AddressSpan) -> bool:
        """Whether all the addresses exist."""
        return span.count > 0 and span.end <= len(self._cells[span.table])

    def cells(self, span: AddressSpan) -> list[Cell]:
        """What lies there."""
        return self._cells[span.table][span.address : span.end]

    def put_cells(self, span: AddressSpan, cells: Sequence[Cell]) -> None:
        """Lay something there."""
        self._cells[span.table][span.address : span.end] = cells

    def get(self, register: Register) -> bool | int | float | str:
        """The value of a register; raises RegisterUnfit."""
        return decode(register, self.cells(register.span))

    def put(self, register: Register, value: bool | float | str) -> None:
        """Give a register a value, of a word with bits only the one; raises RegisterUnfit, and nothing has changed."""
        cells = encode(register, value)
        if register.type is RegisterType.BOOL and not register.table.is_bits:
            (mask,), (word,) = encode(register, True), self.cells(register.span)
            cells = ((int(word) & ~int(mask)) | int(cells[0]),)
        self.put_cells(register.span, cells)
