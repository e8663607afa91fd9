"""The memory of a simulated PLC: four tables, and values in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from ua_fleet.registers import AddressSpan, Table, Tables

__all__ = ["Memory"]

SIZE: Final = 10_000


class Memory(Tables):
    """All addresses from 0 to `size` - 1 of each table. Used in one thread."""

    def __init__(self, size: int = SIZE) -> None:
        """Make one that is all zero."""
        self.size = size
        super().__init__(dict.fromkeys(Table, size))
        self.on_read: Callable[[AddressSpan], None] = lambda span: None
        """Told what a client has read."""
        self.on_write: Callable[[AddressSpan], None] = lambda span: None
        """Told what a client has written."""
