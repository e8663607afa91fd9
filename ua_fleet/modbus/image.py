"""The four tables as PLCs see them. Pure.

What is readable goes from address 0 to the last one that has a meaning, so that a PLC may read over gaps. What is
writable is what has a meaning to be written, and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable

from ua_fleet.registers import AddressSpan, Register, Table, Tables

__all__ = ["Image"]


class Image(Tables):
    """Used in one thread."""

    def __init__(self, read: Iterable[Register], written: Iterable[Register]) -> None:
        """Make tables of zeros with these registers."""
        written = tuple(written)
        spans = [register.span for register in (*read, *written)]
        sizes = {table: max((span.end for span in spans if span.table is table), default=0) for table in Table}
        super().__init__(sizes)
        self._writable = {
            (span.table, address) for span in {r.span for r in written} for address in range(span.address, span.end)
        }

    def can_write(self, span: AddressSpan) -> bool:
        """Whether a PLC may write them."""
        return all((span.table, address) in self._writable for address in range(span.address, span.end))
