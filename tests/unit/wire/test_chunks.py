"""Chunks: what is split comes together again, and each chunk is a message that can be secured alone."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.wire.corpus import mutate, valid_messages
from tests.unit.wire.everything import is_plain, secured_messages
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire import (
    ActionMessage,
    Cause,
    Chunk,
    Codec,
    MessageKey,
    SecurityMode,
    SecurityPolicy,
    encode_action,
    join,
    payload_offset,
    read_chunk,
    read_security,
    split,
)
from ua_fleet.wire.chunks import CHUNK_FIELDS_BYTES, ChunkReader
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage, PublisherIdType

HEAD = bytes.fromhex("f101 0200 01 0300 01 0900")
WHOLE = HEAD + bytes(range(100))
DISCOVERY_HEAD = bytes.fromhex("919108 0700 00 00000000 00")
BYTE_ID_HEAD = bytes.fromhex("11 07")
"""A Byte PublisherId and nothing else: two bytes of flags more in a chunk of it."""

WHOLE_MESSAGES = [
    message
    for message in valid_messages()
    if is_plain(message) and read_chunk(message) is None and len(read_security(message).writer_ids) <= 1
]


def chunk_of(datagram: bytes) -> Chunk:
    chunk = read_chunk(datagram)
    assert chunk is not None
    return chunk


def put_together(datagrams: list[bytes]) -> bytes:
    chunks = sorted(map(chunk_of, datagrams), key=lambda chunk: chunk.offset)
    payload = b"".join(chunk.data for chunk in chunks)
    wholes = {join(chunk, payload) for chunk in chunks}
    assert len(wholes) == 1
    return wholes.pop()


def test_bytes_of_a_chunk() -> None:
    head = bytes.fromhex("f181 01 0200 01 0300 0900")
    size = 40
    most = len(head) + CHUNK_FIELDS_BYTES + size
    assert split(WHOLE, most, 0x0102) == [
        head + struct.pack("<HIII", 0x0102, offset, 100, length) + WHOLE[10 + offset : 10 + offset + length]
        for offset, length in ((0, size), (40, size), (80, 20))
    ]


def test_bytes_of_a_discovery_chunk() -> None:
    """No payload header, the empty SecurityHeader before the chunk's fields, and the announcement's number in them."""
    whole = DISCOVERY_HEAD + bytes(range(60))
    head = bytes.fromhex("919109 0700 00 00000000 00")
    most = len(head) + CHUNK_FIELDS_BYTES + 40
    assert split(whole, most, 7) == [
        head + struct.pack("<HIII", 0x0201, offset, 60, length) + whole[11 + offset : 11 + offset + length]
        for offset, length in ((0, 40), (40, 20))
    ]
    chunk = chunk_of(split(whole, most, 7)[1])
    assert chunk[:6] == (7, PublisherIdType.UINT16, None, None, False, True)


def test_bytes_of_a_chunk_with_a_byte_publisher_id() -> None:
    whole = BYTE_ID_HEAD + bytes(range(20))
    assert split(whole, 20, 7)[0][:4] == bytes.fromhex("91 80 01 07")
    assert put_together(split(whole, 20, 7)) == whole


def test_what_a_chunk_says() -> None:
    chunk = chunk_of(split(WHOLE, 64, 5)[1])
    assert chunk == Chunk(2, PublisherIdType.UINT16, 3, 9, False, False, HEAD, 5, 40, 100, WHOLE[50:90])


@pytest.mark.parametrize("size", [1, 22, 61, len(WHOLE) - 1])
def test_all_chunks_but_the_last_are_equally_long(size: int) -> None:
    most = max(size, 10 + CHUNK_FIELDS_BYTES + 1)
    lengths = [len(datagram) for datagram in split(WHOLE, most, 1)]
    assert set(lengths[:-1]) == {most}
    assert lengths[-1] <= most


def test_what_fits_is_not_split() -> None:
    for most in (len(WHOLE), len(WHOLE) + 1):
        assert split(WHOLE, most, 1) == [WHOLE]
    assert len(split(WHOLE, len(WHOLE) - 1, 1)) == 2


@pytest.mark.parametrize("number", [0, 0xFFFF, 0x10000, 0x12345])
def test_the_sequence_number_is_a_uint16(number: int) -> None:
    assert chunk_of(split(WHOLE, 60, number)[0]).message_sequence_number == number & 0xFFFF


@pytest.mark.parametrize(
    ("flags", "number"), [("09", 0x0B0A), ("89 00", 0x0B0A), ("89 10", 0x0B0A), ("01", 7), ("81 10", 7), ("00", 7)]
)
def test_the_sequence_number_is_that_of_the_data_set_message(flags: str, number: int) -> None:
    whole = HEAD + bytes.fromhex(flags + "0a0b") + bytes(50)
    assert {chunk_of(datagram).message_sequence_number for datagram in split(whole, 50, 7)} == {number}


def test_a_probe_has_no_sequence_number() -> None:
    whole = bytes.fromhex("919104 0700 00 00000000 00") + bytes(range(30))
    assert chunk_of(split(whole, 40, 7)[0]).message_sequence_number == 7


def test_each_chunk_of_an_action_has_its_header() -> None:
    action = ActionMessage(
        2,
        2,
        9,
        1,
        5,
        1,
        is_request=True,
        requestor_id="0.a",
        correlation_data=bytes(16),
        types=(12,),
        values=("x" * 99,),
    )
    whole = encode_action(action)
    header = bytes.fromhex("0d 10000000") + bytes(16) + bytes.fromhex("0c 03000000") + b"0.a"
    chunks = [chunk_of(datagram) for datagram in split(whole, 100, 7)]
    assert len(chunks) > 1
    for chunk in chunks:
        assert chunk.is_action
        assert chunk.action_header == header
        assert chunk.head.endswith(header)
        assert chunk.message_sequence_number == 7
    assert Codec().decode(put_together(split(whole, 100, 7))) == action


def test_every_message_comes_together_again() -> None:
    assert len(WHOLE_MESSAGES) > 20
    key = MessageKey(SecurityPolicy.AES128_CTR, bytes(range(52)))
    for number, whole in enumerate(WHOLE_MESSAGES):
        for most in (len(whole) // 2 + 30, len(whole) - 1):
            if not payload_offset(whole) + CHUNK_FIELDS_BYTES + 3 <= most < len(whole):
                continue  # no room for chunks, or no need of them
            opened: list[bytes] = []
            for index, datagram in enumerate(split(whole, most, number)):
                nonce = struct.pack("<II", number, index)
                secured = key.protect(datagram, payload_offset(datagram), 1, nonce, SecurityMode.SIGN_AND_ENCRYPT)
                heard = read_security(secured)
                assert heard.writer_ids == read_security(whole).writer_ids
                opened.append(key.unprotect(heard))
            random.Random(number).shuffle(opened)
            assert put_together(opened) == whole
            with pytest.raises(RemoteWireError) as caught:
                Codec().decode(opened[0])
            assert caught.value.cause == Cause.CHUNK


@given(
    head=st.sampled_from([HEAD, DISCOVERY_HEAD, BYTE_ID_HEAD]),
    payload=st.binary(max_size=300),
    most=st.integers(28, 330),
    number=st.integers(0, 0xFFFF),
)
def test_round_trip(head: bytes, payload: bytes, most: int, number: int) -> None:
    whole = head + payload
    datagrams = split(whole, most, number)
    assert all(len(datagram) <= most for datagram in datagrams)
    if datagrams == [whole]:
        assert read_chunk(whole) is None
        return
    chunks = [chunk_of(datagram) for datagram in datagrams]
    assert len({chunk.message_sequence_number for chunk in chunks}) == 1
    assert {chunk.total_size for chunk in chunks} == {len(payload)}
    assert put_together(datagrams) == whole


def test_several_data_set_messages_are_never_split() -> None:
    parts = tuple(DataSetMessage(number, types=(11,), values=(1.5,)) for number in (1, 2, 3))
    whole = Codec().encode(NetworkMessage(2, PublisherIdType.UINT16, writer_group_id=2, messages=parts))
    assert split(whole, len(whole), 1) == [whole]
    with pytest.raises(LocalWireError, match="3 DataSetMessages"):
        split(whole, len(whole) - 1, 1)


def test_what_cannot_be_split() -> None:
    chunk = split(WHOLE, 60, 1)[0]
    with pytest.raises(LocalWireError, match="a chunk"):
        split(chunk, 50, 1)
    with pytest.raises(LocalWireError, match="no room"):
        split(WHOLE, 10 + CHUNK_FIELDS_BYTES, 1)
    for secured in secured_messages()[:4]:
        with pytest.raises(LocalWireError, match="secured"):
            split(secured, len(secured) - 1, 1)
    with pytest.raises(LocalWireError, match="cannot be split"):
        split(b"\2" * 100, 50, 1)


def test_what_cannot_be_joined() -> None:
    chunk = chunk_of(split(WHOLE, 60, 1)[0])
    for payload in (b"", WHOLE[10:-1], WHOLE[10:] + b"\0"):
        with pytest.raises(LocalWireError):
            join(chunk, payload)


def test_flags_that_could_have_been_left_out() -> None:
    """ExtendedFlags that are 0 are not sent again."""
    whole = bytes.fromhex("f1 80 00 07 01 0300 01 0900") + bytes(range(50))
    shortest = bytes.fromhex("71 07 01 0300 01 0900") + bytes(range(50))
    assert put_together(split(whole, 50, 1)) == shortest
    assert split(whole, 50, 1) == split(shortest, 50, 1)


def test_whatever_has_a_head_is_split_or_refused() -> None:
    chance = random.Random(3)
    several = 0
    for _ in range(5_000):
        whole = mutate(chance, WHOLE_MESSAGES)
        try:
            datagrams = split(whole, 60, 1)
        except LocalWireError:
            continue
        if len(datagrams) > 1:
            assert whole.endswith(put_together(datagrams)[payload_offset(whole) :])
            several += 1
    assert several > 500


def test_what_is_no_chunk() -> None:
    for message in [*WHOLE_MESSAGES, b"", b"\xf1", b"\xf1\x81", b"\xf1\x01\x01"]:
        assert read_chunk(message) is None


def test_a_chunk_of_another_length_is_refused() -> None:
    datagram = split(WHOLE, 60, 1)[-1]
    for size in range(3, len(datagram)):
        try:
            chunk = read_chunk(datagram[:size])
        except RemoteWireError as error:
            assert error.cause == Cause.TRUNCATED  # noqa: PT017 - the first ones are no chunks
        else:
            assert chunk is None
    with pytest.raises(RemoteWireError) as caught:
        read_chunk(datagram + b"\0")
    assert caught.value.cause == Cause.TRAILING_BYTES


@settings(max_examples=50)
@given(st.lists(st.integers(0, 10_000), min_size=1, max_size=12), st.integers(0, 1 << 32))
def test_a_reader_of_many_chunks_reads_each_as_if_it_were_alone(order: list[int], seed: int) -> None:
    """Chunks of several messages and writers in any order, some of them broken."""
    chunks = [part for whole in WHOLE_MESSAGES for part in split(whole, max(len(whole) - 1, 60), 5)]
    chance, reader = random.Random(seed), ChunkReader()
    for number in order:
        datagram = chunks[number % len(chunks)]
        cut = datagram[: chance.randrange(len(datagram))]
        for each in (datagram, mutate(chance, [datagram]), cut, datagram):
            assert outcome_of(reader.read, each) == outcome_of(read_chunk, each)


def outcome_of(read: Callable[[bytes], Chunk | None], datagram: bytes) -> object:
    try:
        return read(datagram)
    except RemoteWireError as error:
        return error.cause
