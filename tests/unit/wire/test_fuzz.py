"""Mutated valid messages: only RemoteWireError comes out, and it is counted by cause."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from tests.unit.wire.corpus import RAW_METADATA, mutate
from tests.unit.wire.everything import KEYS, chunked_messages, plain_messages, secured_messages
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.wire import Cause, Codec, decode_raw_fields
from ua_fleet.wire.chunks import join, read_chunk
from ua_fleet.wire.messages import NetworkMessage
from ua_fleet.wire.security import SecurityMode, payload_offset, read_security

SHARES = 4
MUTATIONS = 200_000
SECURED_MUTATIONS = 60_000
"""Of messages as they travel, and as many of what their sender has signed: a member of the group may lie too."""


@pytest.mark.parametrize("share", range(SHARES))
def test_only_the_typed_remote_error_escapes(share: int) -> None:
    corpus = plain_messages()
    chance = random.Random(20_261_121 + share)
    codec = Codec()
    for _ in range(3):  # so that there are plans
        for data in corpus:
            _count(codec, data, Counter())
    causes: Counter[str] = Counter()
    for _ in range(MUTATIONS // SHARES):
        _count(codec, mutate(chance, corpus), causes)
    assert causes.total() == MUTATIONS // SHARES
    assert set(causes) - {"decoded"} <= set(Cause)
    assert len(causes) > 25
    assert causes["decoded"] > MUTATIONS // SHARES // 10


def _count(codec: Codec, data: bytes, causes: Counter[str]) -> None:
    try:
        decoded = codec.decode(data)
        if isinstance(decoded, NetworkMessage):
            for part in decoded.messages:
                decode_raw_fields(part, RAW_METADATA)
    except RemoteWireError as error:
        causes[error.cause] += 1
    else:
        causes["decoded"] += 1


def _take(codec: Codec, datagram: bytes, causes: Counter[str]) -> None:
    """Open with whichever key fits, put together, decode."""
    try:
        heard = read_security(datagram)
        plain = datagram if heard.mode is SecurityMode.NONE else KEYS[heard.token_id % 2].unprotect(heard)
        chunk = read_chunk(plain)
    except RemoteWireError as error:
        causes[error.cause] += 1
        return
    if chunk is not None:
        causes["chunks"] += 1
        if chunk.total_size != len(chunk.data):
            return
        plain = join(chunk, chunk.data)
    _count(codec, plain, causes)


def test_secured_and_chunked_messages() -> None:
    corpus = [*secured_messages(), *chunked_messages()]
    chance = random.Random(20_261_122)
    codec = Codec()
    causes: Counter[str] = Counter()
    for _ in range(SECURED_MUTATIONS):
        _take(codec, mutate(chance, corpus), causes)
    assert set(causes) - {"decoded", "chunks"} <= set(Cause)
    assert causes[Cause.SIGNATURE] > SECURED_MUTATIONS // 2
    assert {Cause.SECURITY_FLAGS, Cause.NONCE_LENGTH, Cause.SECURITY_FOOTER, Cause.CHUNK_RANGE} <= set(causes)


def test_a_member_of_the_group_that_signs_what_is_wrong() -> None:
    corpus = [*plain_messages(), *chunked_messages()]
    chance = random.Random(20_261_123)
    codec = Codec()
    causes: Counter[str] = Counter()
    for number in range(SECURED_MUTATIONS):
        plain = mutate(chance, corpus)
        try:
            offset = payload_offset(plain)
            mode = (SecurityMode.SIGN, SecurityMode.SIGN_AND_ENCRYPT)[number // 2 % 2]
            secured = KEYS[number % 2].protect(plain, offset, number % 2, number.to_bytes(8, "little"), mode)
        except (LocalWireError, RemoteWireError):
            continue  # no head that could be secured
        _take(codec, secured, causes)
    assert Cause.SIGNATURE not in causes
    assert set(causes) - {"decoded", "chunks"} <= set(Cause)
    assert causes.total() > SECURED_MUTATIONS // 2
    assert len(causes) > 20


def test_noise() -> None:
    chance = random.Random(7)
    codec = Codec()
    causes: Counter[str] = Counter()
    for _ in range(5_000):
        _count(codec, chance.randbytes(chance.randrange(80)), causes)
    assert causes["decoded"] < 50
