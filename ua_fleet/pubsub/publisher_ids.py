"""PublisherIds on the wire that are not the number of a space (OPC 10000-14 6.2.7.1).

Inside a process a publisher is its space, a UInt16. A bridge whose `publisher_id` is configured has another name on the
wire, of any type: what is sent in its name, and what is asked of it, is renamed before it is secured, and what is heard
after it was verified. Nothing else knows of it, and keys and rights go by the space.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, TypeVar

from ua_fleet.errors import RemoteWireError
from ua_fleet.values import BuiltinType, Variant
from ua_fleet.wire.chunks import Chunk
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.header import (
    HAS_PUBLISHER_ID,
    PUBLISHER_ID_BUILTIN,
    PUBLISHER_ID_TYPE_BITS,
    decode_flags,
    decode_publisher_id,
    encode_publisher_id,
)
from ua_fleet.wire.messages import PublisherIdType
from ua_fleet.wire.outline import encode_flags
from ua_fleet.wire.security import SecuredDatagram

__all__ = ["PublisherId", "PublisherIds"]

PublisherId = tuple[int, int | str]
"""Type and value."""

_UINT16: Final = PublisherIdType.UINT16.value
_SPACE_BYTES: Final = 2
_Named = TypeVar("_Named", SecuredDatagram, Chunk)


class PublisherIds:
    """The PublisherIds of those spaces that have one of their own."""

    def __init__(self, ids: Mapping[int, PublisherId]) -> None:
        """`ids` are those of spaces; none of them is the UInt16 of another space."""
        self._outward: dict[PublisherId, PublisherId] = {(_UINT16, space): wire for space, wire in ids.items()}
        self._inward = {wire: space for space, wire in self._outward.items()}
        sizes = [len(_encoded(wire)) for wire in ids.values()]
        self.most_added_bytes = max([size - _SPACE_BYTES for size in sizes], default=0)
        """How much longer a renamed message may be."""

    def variant(self, space: int) -> Variant:
        """The PublisherId of a space."""
        kind, value = self._outward.get((_UINT16, space), (_UINT16, space))
        return Variant(int(PUBLISHER_ID_BUILTIN.get(kind, BuiltinType.STRING)), value)

    def outward(self, datagram: bytes) -> bytes:
        """A message, or its head, as it goes over the wire."""
        return _renamed(datagram, self._outward)

    def inward(self, datagram: bytes) -> bytes:
        """A message that was heard, with the space in place of its PublisherId."""
        return _renamed(datagram, self._inward)

    def named(self, heard: _Named) -> _Named:
        """What was read of a message, with the space in place of its PublisherId."""
        publisher_id = heard.publisher_id
        space = None if publisher_id is None else self._inward.get((heard.publisher_id_type, publisher_id))
        return heard if space is None else heard._replace(publisher_id=space[1], publisher_id_type=space[0])


def _renamed(datagram: bytes, names: Mapping[PublisherId, PublisherId]) -> bytes:
    cursor = Cursor(datagram)
    try:
        flags, extended1, extended2 = decode_flags(cursor)
        if not flags & HAS_PUBLISHER_ID:
            return datagram
        value, kind = decode_publisher_id(cursor, extended1)
    except RemoteWireError:
        return datagram  # who decodes it says what is wrong
    name = names.get((kind, value))
    if name is None:
        return datagram
    head = encode_flags(flags, (extended1 & ~PUBLISHER_ID_TYPE_BITS) | name[0], extended2)
    return b"".join((head, _encoded(name), datagram[cursor.position :]))


def _encoded(publisher_id: PublisherId) -> bytes:
    out = bytearray()
    encode_publisher_id(out, publisher_id[1], publisher_id[0])
    return bytes(out)
