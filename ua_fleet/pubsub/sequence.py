"""Sequence numbers of 16 bits: which of two is newer (OPC 10000-14 7.2.3, with the bounds scaled to UInt16).

With d = (2^16 - 1 + received - last) mod 2^16 a number is newer for d < 2^14, old or the same for d > 3 * 2^14 and
invalid between. In steps = (received - last) mod 2^16, which is d + 1, and how far the writer went on:

    steps     1 .. 2^14          newer; steps - 1 messages are missing
              0, 3 * 2^14 + 2 .. old or the same
              between            invalid
"""

from __future__ import annotations

from typing import Final

__all__ = ["MASK", "NEWEST_STEP", "MissingNumbers"]

MASK: Final = 0xFFFF
NEWEST_STEP: Final = 0x4000
"""The most steps that still mean newer."""

_REMEMBERED: Final = 256
"""How many missing numbers a reader remembers: beyond, what comes late looks like a duplicate."""


class MissingNumbers:
    """The numbers that one writer's messages skipped, so that a late message is told from a duplicate."""

    __slots__ = ("_numbers",)

    def __init__(self) -> None:
        self._numbers: dict[int, None] = {}

    def skipped(self, first: int, count: int) -> None:
        """Remember `count` numbers from `first` on, the newest of them where there are too many."""
        numbers = self._numbers
        for offset in range(max(0, count - _REMEMBERED), count):
            number = (first + offset) & MASK
            numbers.pop(number, None)
            numbers[number] = None
        while len(numbers) > _REMEMBERED:
            del numbers[next(iter(numbers))]

    def arrived(self, number: int, last: int) -> bool:
        """Whether `number` was missing and comes now, `last` being the newest heard; forgets it."""
        if number not in self._numbers:
            return False
        del self._numbers[number]
        return (last - number) & MASK < NEWEST_STEP

    def clear(self) -> None:
        """Forget all: the writer began anew."""
        self._numbers.clear()
