"""Mutated valid messages: only RemoteWireError comes out, and it is counted by cause."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from tests.unit.wire.corpus import RAW_METADATA, mutate, valid_messages
from ua_fleet.errors import RemoteWireError
from ua_fleet.wire import Cause, Codec, decode_raw_fields
from ua_fleet.wire.messages import NetworkMessage

SHARES = 4
MUTATIONS = 200_000


@pytest.mark.parametrize("share", range(SHARES))
def test_only_the_typed_remote_error_escapes(share: int) -> None:
    corpus = valid_messages()
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


def test_noise() -> None:
    chance = random.Random(7)
    codec = Codec()
    causes: Counter[str] = Counter()
    for _ in range(5_000):
        _count(codec, chance.randbytes(chance.randrange(80)), causes)
    assert causes["decoded"] < 50
