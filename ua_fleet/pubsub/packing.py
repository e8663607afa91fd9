"""DataSetMessages of one WriterGroup packed into NetworkMessages that fit an Ethernet frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final

from ua_fleet.wire.messages import DataSetMessage

__all__ = ["HEADER_BYTES", "KEEP_ALIVE_BYTES", "MAX_PACKED_BYTES", "pack"]

MAX_PACKED_BYTES: Final = 1400
"""Fits one Ethernet frame of 1500 bytes with the headers of IP, UDP and a tunnel (OPC 10000-14 6.4.1 advises 1472)."""
HEADER_BYTES: Final = 10
"""A NetworkMessage of one DataSetMessage: flags 2, PublisherId 2, GroupHeader 3, Count 1, one DataSetWriterId 2."""
KEEP_ALIVE_BYTES: Final = 12
"""A keep-alive of ours: flags 2, sequence number 2, major and minor version 8."""
_EACH_BYTES: Final = 4
"""What each of several DataSetMessages adds to the header: DataSetWriterId and Size."""
_MAX_COUNT: Final = 255


def pack(
    messages: Iterable[tuple[DataSetMessage, int]], most_bytes: int = MAX_PACKED_BYTES
) -> Iterator[tuple[DataSetMessage, ...]]:
    """Split DataSetMessages, each with its size in bytes, into tuples that share a NetworkMessage.

    A message that is too large by itself stands alone.
    """
    batch: list[DataSetMessage] = []
    total = HEADER_BYTES
    for message, size in messages:
        if batch and (total + _EACH_BYTES + size > most_bytes or len(batch) == _MAX_COUNT):
            yield tuple(batch)
            batch, total = [], HEADER_BYTES
        batch.append(message)
        total += _EACH_BYTES + size
    if batch:
        yield tuple(batch)
