"""Chunks as two other implementations lay them out. No program of theirs has sent them to us.

The bytes are those that their own tests state: Eclipse Milo's of what it reassembles, and those of UA-.NETStandard of
what it sends (OPC 10000-14 tables 158 and 159).
"""

from __future__ import annotations

import struct

import pytest

from tests.unit.pubsub.publishing import CODEC
from tests.unit.pubsub.security.securing import NONE, envelope
from ua_fleet.values import BuiltinType
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage

MILO = (
    # Version 1, GroupHeader, PayloadHeader; ExtendedFlags2: a chunk. WriterGroupId 258, SequenceNumbers 16 and 17,
    # DataSetWriterId 5, MessageSequenceNumber 7. No PublisherId.
    "e1 80 01 09 0201 1000 0500 0700 00000000 08000000 04000000 01010006",
    "e1 80 01 09 0201 1100 0500 0700 04000000 08000000 04000000 2a000000",
)
"""A key frame with the Int32 42, in two parts."""
SIZE = 40
VALUE = bytes(index * 7 & 0xFF for index in range(SIZE))


def net_standard() -> list[bytes]:
    """A key frame with 40 bytes, in messages of at most 40."""
    # PublisherId 7 (Byte), WriterGroupId 3, DataSetWriterId 21: the header has no ExtendedFlags1 but the one that says
    # that ExtendedFlags2 follow.
    head = bytes.fromhex("f1 80 01 07 01 0300 1500")
    data_set_message = bytes.fromhex("09 d204 0100 0f") + struct.pack("<I", SIZE) + VALUE
    room = SIZE - len(head) - 14
    return [
        head + struct.pack("<HIII", 1234, start, len(data_set_message), len(part)) + part
        for start in range(0, len(data_set_message), room)
        for part in [data_set_message[start : start + room]]
    ]


def put_together(datagrams: list[bytes]) -> NetworkMessage:
    opening = envelope(0, mode=NONE)
    *before, last = [opening.open(datagram, 0.0) for datagram in datagrams]
    assert before == [None] * (len(datagrams) - 1)
    assert last is not None
    message = CODEC.decode(last)
    assert isinstance(message, NetworkMessage)
    return message


def only_part(message: NetworkMessage) -> DataSetMessage:
    (part,) = message.messages
    return part


@pytest.mark.parametrize("step", [1, -1], ids=["in order", "the last one first"])
def test_chunks_as_milo_reassembles_them(step: int) -> None:
    message = put_together([bytes.fromhex(text) for text in MILO[::step]])
    part = only_part(message)
    assert (message.publisher_id, message.writer_group_id, part.data_set_writer_id) == (None, 258, 5)
    assert (part.valid, part.types, part.values) == (True, (BuiltinType.INT32,), (42,))


@pytest.mark.parametrize("step", [1, -1], ids=["in order", "the last one first"])
def test_chunks_as_ua_net_standard_sends_them(step: int) -> None:
    datagrams = net_standard()
    assert len(datagrams) > 2
    assert max(map(len, datagrams)) == SIZE
    message = put_together(datagrams[::step])
    part = only_part(message)
    assert (message.publisher_id, message.writer_group_id, part.data_set_writer_id) == (7, 3, 21)
    assert (part.sequence_number, part.types, part.values) == (1234, (BuiltinType.BYTE_STRING,), (VALUE,))
