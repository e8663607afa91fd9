"""Blocks of a history that are kept decoded: pages and calculations go through them piece by piece."""

from __future__ import annotations

import gc
import struct
import zlib
from collections import OrderedDict
from collections.abc import Generator
from contextlib import contextmanager
from typing import Final, NamedTuple

from ua_fleet.errors import RemoteWireError
from ua_fleet.history.blocks import decode_block, has_fixed_size
from ua_fleet.history.rows import Row, Rows, value_bytes
from ua_fleet.values import TICKS_PER_SECOND

__all__ = ["BLOCK_BYTES", "BLOCK_ROWS", "BROKEN", "OVERDUE", "ROUND", "DecodedBlocks", "uncollected"]

BLOCK_ROWS: Final = 1_000
"""Of one block."""
BLOCK_BYTES: Final = 1_000_000
"""What the values of a block take in memory; the row with which they take more is its last one."""
ROUND: Final = 60 * TICKS_PER_SECOND
"""From one removal of what is too old or too much to the next."""
OVERDUE: Final = ROUND
"""So long a removal waits for compaction, which may make it needless; then it goes first."""
BROKEN: Final = (RemoteWireError, zlib.error, struct.error, ValueError, KeyError, IndexError)
"""What is raised for rows and blocks that are broken."""
_MOST: Final = 16
_MOST_BYTES: Final = 16 * BLOCK_BYTES


@contextmanager
def uncollected() -> Generator[None]:
    """Make rows without garbage collection. None of them is in a cycle, and to look for cycles among those of a day
    takes half of the time in which they are made.

    It is for one read, which is bounded, and not for what waits for a network or for what is calculated: meanwhile all
    garbage of the process stays.
    """
    if not gc.isenabled():  # another has paused it, and sees to the rest
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class _Block(NamedTuple):
    rows: list[Row]
    size: int
    """Bytes of its values; 0 where they have a fixed size."""


class DecodedBlocks:
    """The blocks that were read last, by node and first time; as many as take little memory."""

    def __init__(self) -> None:
        self._blocks: OrderedDict[tuple[int, int], _Block] = OrderedDict()
        self._size = 0

    def __contains__(self, key: tuple[int, int]) -> bool:
        return key in self._blocks

    def clear(self) -> None:
        """Forget all: some are gone from the store."""
        self._blocks.clear()
        self._size = 0

    def add(self, key: tuple[int, int], data: bytes) -> None:
        """Keep a block in place of older ones; raises one of `BROKEN`."""
        rows = decode_block(data)
        size = 0 if has_fixed_size(data) else sum(value_bytes(row.value) for row in rows)
        while self._blocks and (len(self._blocks) >= _MOST or self._size + size > _MOST_BYTES):
            _, old = self._blocks.popitem(last=False)
            self._size -= old.size
        self._blocks[key] = _Block(rows, size)
        self._size += size

    def put_into(self, found: Rows, key: tuple[int, int], first: int, last: int, *, backward: bool) -> None:
        """Add those rows of a block that is here to what was found whose times are from `first` to `last`."""
        self._blocks.move_to_end(key)
        rows, size = self._blocks[key]
        if rows[0].time < first or rows[-1].time > last:
            rows = [row for row in rows if first <= row.time <= last]
        if backward:
            rows = rows[::-1]
        if size:
            found.take(rows)
        else:
            found.take_numbers(rows)
