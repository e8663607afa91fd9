"""The order of a DataValue's times on the wire.

OPC 10000-6 5.2.2.17 has SourceTimestamp, SourcePicoSeconds, ServerTimestamp, ServerPicoSeconds; asyncua reads and
writes SourcePicoSeconds behind ServerTimestamp. So where both are there, they change places before asyncua reads them.
What has no picoseconds costs one comparison. DataValues inside of Variants are left alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

__all__ = ["MOST_PICOSECONDS", "in_asyncuas_order", "misplaced"]

MOST_PICOSECONDS: Final = 9_999
"""In units of 10 ps; larger ones stand for it (OPC 10000-6 5.2.2.17)."""
_SERVER_TIME_AND_SOURCE_PICOSECONDS: Final = 0x08 | 0x10
_SERVER_PICOSECONDS: Final = 0x20
_TIME: Final = 8
_PICOSECONDS: Final = 2
_BOTH: Final = _TIME + _PICOSECONDS


def misplaced(mask: int, end: int) -> int:
    """Where SourcePicoSeconds and ServerTimestamp begin that have to change places; -1 where they need not.

    Args:
        mask: first byte of the DataValue.
        end: position behind its last one.
    """
    if mask & _SERVER_TIME_AND_SOURCE_PICOSECONDS != _SERVER_TIME_AND_SOURCE_PICOSECONDS:
        return -1
    return end - _BOTH - (_PICOSECONDS if mask & _SERVER_PICOSECONDS else 0)


def in_asyncuas_order(data: bytes, places: Sequence[int]) -> bytes:
    """Bytes with DataValues as the standard has them, as asyncua reads them; `places` are those of `misplaced`."""
    ordered = bytearray(data)
    for at in places:
        ordered[at : at + _BOTH] = data[at + _PICOSECONDS : at + _BOTH] + data[at : at + _PICOSECONDS]
    return bytes(ordered)
