"""The four tables as PLCs see them. Pure.

What is readable goes from address 0 to the last one that has a meaning, so that a PLC may read over gaps. What is
writable is what has a meaning to be written, and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from ua_fleet.registers import Cell, Register, RegisterType, Span, Table, decode, encode

__all__ = ["Image"]


class Image:
    """Used in one thread."""

    def __init__(self, read: Iterable[Register], written: Iterable[Register]) -> None:
        """Make tables of zeros with these registers."""
        written = tuple(written)
        spans = [register.span for register in (*read, *written)]
        sizes = {table: max((span.end for span in spans if span.table is table), default=0) for table in Table}
        self._cells: dict[Table, list[Cell]] = {
            table: [False] * size if table.is_bits else [0] * size for table, size in sizes.items()
        }
        self._writable = {
            (span.table, address) for span in {r.span for r in written} for address in range(span.address, span.end)
        }

    def can_read(self, span: Span) -> bool:
        """Whether a PLC may read these addresses."""
        return span.count > 0 and span.end <= len(self._cells[span.table])

    def can_write(self, span: Span) -> bool:
        """Whether a PLC may write them."""
        return all((span.table, address) in self._writable for address in range(span.address, span.end))

    def cells(self, span: Span) -> list[Cell]:
        """What lies there."""
        return self._cells[span.table][span.address : span.end]

    def put_cells(self, span: Span, cells: Sequence[Cell]) -> None:
        """What a PLC has written."""
        self._cells[span.table][span.address : span.end] = cells

    def get(self, register: Register) -> bool | float | str:
        """The value of a register; raises RegisterUnfit."""
        return decode(register, self.cells(register.span))

    def put(self, register: Register, value: bool | float | str) -> None:
        """Show a value; raises RegisterUnfit, and nothing has changed."""
        cells = encode(register, value)
        if register.type is RegisterType.BOOL and not register.table.is_bits:
            (mask,), (word,) = encode(register, True), self.cells(register.span)
            cells = ((int(word) & ~int(mask)) | int(cells[0]),)
        self.put_cells(register.span, cells)
