"""Tokens: bytes in both directions, never more than 1,200, and nothing but TokenInvalid for what strangers send."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.carrying.token import (
    MOST_LOOPS,
    MOST_RUN_ID,
    MOST_TEXT_BYTES,
    MOST_TOKEN_BYTES,
    WHOLE,
    Token,
    TokenInvalid,
    decode_token,
    encode_token,
    most_bytes,
)
from ua_fleet.scenario import Value
from ua_fleet.values import BuiltinType

HASH = bytes(range(8))
KINDS = (BuiltinType.BOOLEAN, BuiltinType.INT64, BuiltinType.DOUBLE, BuiltinType.UINT64, BuiltinType.STRING)
VALUES: dict[BuiltinType, st.SearchStrategy[Value]] = {
    BuiltinType.BOOLEAN: st.booleans(),
    BuiltinType.INT64: st.integers(-(1 << 63), (1 << 63) - 1),
    BuiltinType.DOUBLE: st.floats(allow_nan=False),
    BuiltinType.UINT64: st.integers(0, (1 << 64) - 1),
    BuiltinType.STRING: st.text(max_size=MOST_TEXT_BYTES).filter(
        lambda text: len(text.encode("utf-8", "replace")) <= MOST_TEXT_BYTES and text.isprintable()
    ),
}


@st.composite
def results(draw: st.DrawFn) -> tuple[tuple[BuiltinType, ...], dict[str, Value]]:
    """Types of the results that a segment needs, and those that there are."""
    kinds = tuple(draw(st.lists(st.sampled_from(KINDS), max_size=120)))
    there = draw(st.lists(st.booleans(), min_size=len(kinds), max_size=len(kinds)))
    values: dict[str, Value] = {f"t{n}.out": draw(VALUES[kind]) for n, kind in enumerate(kinds) if there[n]}
    return kinds, values


ROUNDS = st.lists(st.integers(0, (1 << 32) - 1), max_size=MOST_LOOPS).map(tuple)


@given(
    results(), st.integers(0, 0xFFFF), st.integers(0, 254), st.text("0123-ab", min_size=1, max_size=MOST_RUN_ID), ROUNDS
)
def test_no_token_is_larger_than_its_plan_was_told(
    made: tuple[tuple[BuiltinType, ...], dict[str, Value]],
    segment: int,
    slot: int,
    run_id: str,
    rounds: tuple[int, ...],
) -> None:
    kinds, values = made
    names = [f"t{number}.out" for number in range(len(kinds))]
    token = Token(run_id, HASH, 7, segment, slot, "", values, rounds)
    content = encode_token(token, names)
    assert len(content) <= most_bytes(kinds, len(rounds))
    if most_bytes(kinds, len(rounds)) <= MOST_TOKEN_BYTES:
        assert decode_token(content, {segment: [names] * WHOLE}) == token


@given(st.text(min_size=1, max_size=2000))
def test_why_a_branch_has_failed_fits_as_far_as_it_goes(reason: str) -> None:
    content = encode_token(Token("run", HASH, 1, 3, WHOLE, reason), ["a.b"] * 100)
    assert len(content) <= most_bytes(()) <= MOST_TOKEN_BYTES
    failed = decode_token(content, {3: ()}).failed
    assert failed
    assert reason.encode("utf-8", "replace").decode().startswith(failed)


@given(st.binary(max_size=100))
def test_whatever_a_stranger_sends_is_refused_or_read(content: bytes) -> None:
    with contextlib.suppress(TokenInvalid):
        decode_token(content, {0: [("a.b",)], 1: [()]})


@given(results(), st.data())
def test_a_token_that_was_changed_on_its_way_is_refused_or_another_one(
    made: tuple[tuple[BuiltinType, ...], dict[str, Value]], data: st.DataObject
) -> None:
    kinds, values = made
    names = [f"t{number}.out" for number in range(len(kinds))]
    token = Token("run", HASH, 1, 3, 0, "", values)
    content = bytearray(encode_token(token, names))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(TokenInvalid):
        decode_token(bytes(content), {3: [names]})


def test_a_text_or_a_number_that_is_too_long_is_refused() -> None:
    with pytest.raises(TokenInvalid, match="a text of 65 bytes"):
        encode_token(Token("run", HASH, 1, 0, 0, "", {"a.b": "x" * 65}), ["a.b"])
    with pytest.raises(TokenInvalid, match="more than 64 bits"):
        encode_token(Token("run", HASH, 1, 0, 0, "", {"a.b": 1 << 64}), ["a.b"])


def test_a_token_of_another_version_or_segment_says_so() -> None:
    content = encode_token(Token("run", HASH, 1, 0, 0), ())
    with pytest.raises(TokenInvalid, match="version 1 with"):
        decode_token(b"\1" + content[1:])
    with pytest.raises(TokenInvalid, match="segment 0 of run run is not of this bridge"):
        decode_token(content, {5: [()]})
    for slot, said in ((4, "has no slot 4"), (WHOLE, "says why the segment has failed")):
        with pytest.raises(TokenInvalid, match=said):
            decode_token(encode_token(Token("run", HASH, 1, 0, slot), ()), {0: [()]})
    with pytest.raises(TokenInvalid, match="in the repetitions"):
        encode_token(Token("run", HASH, 1, 0, 0, rounds=(0,) * (MOST_LOOPS + 1)), ())
    with pytest.raises(TokenInvalid, match="within 17 repetitions"):
        decode_token(content[:19] + bytes([MOST_LOOPS + 1]) + content[20:])
    with pytest.raises(TokenInvalid, match="at most 1200"):
        decode_token(bytes(1201))
