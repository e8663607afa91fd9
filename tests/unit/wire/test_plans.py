"""Compiled plans give what the generic codec gives: the same message, the same bytes, or the same cause."""

from __future__ import annotations

import math
import random
import struct
from typing import Any
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.wire.corpus import EVERY_TYPE, mutate, valid_messages
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, Matrix, Variant
from ua_fleet.wire import Codec
from ua_fleet.wire import codec as codec_module
from ua_fleet.wire.decode_plan import MOST_PLANNED_FIELDS, prefix_length
from ua_fleet.wire.encode_plan import MOST_NAMED_FIELDS, WriterPlan
from ua_fleet.wire.generic import decode_message, encode_message
from ua_fleet.wire.messages import DataSetMessage, FrameKind, NetworkMessage, PublisherIdType

UINT16 = st.integers(0, 0xFFFF)
UINT32 = st.integers(0, 0xFFFF_FFFF)
INT64 = st.integers(-(1 << 63), (1 << 63) - 1)
FLOAT32 = st.floats(width=32, allow_nan=False)

SCALARS: dict[int, st.SearchStrategy[Any]] = {
    0: st.none(),
    1: st.booleans(),
    2: st.integers(-128, 127),
    3: st.integers(0, 255),
    4: st.integers(-0x8000, 0x7FFF),
    5: UINT16,
    6: st.integers(-(1 << 31), (1 << 31) - 1),
    7: UINT32,
    8: INT64,
    9: st.integers(0, (1 << 64) - 1),
    10: FLOAT32,
    11: st.floats(allow_nan=False),
    12: st.none() | st.text(max_size=12),
    13: INT64,
    14: st.uuids(),
    15: st.none() | st.binary(max_size=12),
    16: st.none() | st.text(max_size=12),
    19: UINT32,
    **{value.type: st.just(value.value) for value in EVERY_TYPE if value.type in (17, 18, 20, 21, 22, 23, 25)},
}


@st.composite
def fields(draw: st.DrawFn) -> Variant:
    kind = draw(st.sampled_from(sorted(SCALARS)))
    shape = draw(st.sampled_from((0, 0, 0, ARRAY, ARRAY | DIMENSIONS))) if kind else 0
    if not shape:
        return Variant(kind, draw(SCALARS[kind]))
    if shape == ARRAY:
        return Variant(kind | shape, draw(st.none() | st.lists(SCALARS[kind], max_size=4).map(tuple)))
    rows, columns = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    elements = draw(st.lists(SCALARS[kind], min_size=rows * columns, max_size=rows * columns))
    return Variant(kind | shape, Matrix(tuple(elements), (rows, columns)))


def optional(strategy: st.SearchStrategy[int]) -> st.SearchStrategy[int | None]:
    return st.none() | strategy


PUBLISHER_IDS: st.SearchStrategy[tuple[int | str | None, int]] = st.one_of(
    st.tuples(UINT16, st.just(PublisherIdType.UINT16.value)),
    st.tuples(st.integers(0, 255), st.just(PublisherIdType.BYTE.value)),
    st.tuples(UINT32, st.just(PublisherIdType.UINT32.value)),
    st.tuples(UINT32, st.just(PublisherIdType.UINT64.value)),
    st.tuples(st.text(max_size=5), st.just(PublisherIdType.STRING.value)),
    st.just((None, PublisherIdType.UINT16.value)),
)


@st.composite
def network_messages(draw: st.DrawFn) -> NetworkMessage:
    """Single key frames: of what we send, and of what peers send that is nearly the same."""
    values = draw(st.lists(fields(), max_size=20))
    has_payload_header = draw(st.booleans())
    part = DataSetMessage(
        draw(UINT16) if has_payload_header else 0,
        types=tuple(value.type for value in values),
        values=tuple(value.value for value in values),
        sequence_number=draw(optional(UINT16)),
        timestamp=draw(optional(INT64)),
        picoseconds=draw(optional(UINT16)),
        status=draw(optional(UINT16.map(lambda status: status << 16))),
        major_version=draw(optional(UINT32)),
        minor_version=draw(optional(UINT32)),
    )
    publisher_id, publisher_id_type = draw(PUBLISHER_IDS)
    return NetworkMessage(
        publisher_id,
        publisher_id_type,
        writer_group_id=draw(optional(UINT16)),
        sequence_number=draw(optional(UINT16)),
        payload_header=has_payload_header,
        messages=(part,),
    )


def outcome(decode: Any, data: bytes) -> tuple[str, Any]:
    """What comes out, in a form that can be compared: NaN is equal to itself."""
    try:
        return "decoded", repr(decode(data))
    except RemoteWireError as error:
        return "refused", error.cause


@given(message=network_messages(), again=st.data())
@settings(max_examples=400)
def test_same_message_and_same_bytes(message: NetworkMessage, again: st.DataObject) -> None:
    codec = Codec()
    data = encode_message(message)
    assert decode_message(data) == message
    for _ in range(3):
        assert codec.decode(data) == message
        assert codec.encode(message) == data
    # The same layout with other values, as the writer's next message has them.
    part = message.messages[0]
    variants = [Variant(code, value) for code, value in zip(part.types, part.values, strict=True)]
    values = tuple(again.draw(SCALARS[code]) if code in SCALARS else value for code, value in variants)
    other = message._replace(messages=(part._replace(values=values),))
    data = encode_message(other)
    assert codec.decode(data) == other
    assert codec.encode(other) == data


@given(message=network_messages(), at=st.integers(0, 200), byte=st.integers(0, 255), cut=st.integers(0, 200))
@settings(max_examples=400)
def test_same_outcome_for_a_message_gone_wrong(message: NetworkMessage, at: int, byte: int, cut: int) -> None:
    codec = Codec()
    data = encode_message(message)
    for _ in range(3):
        codec.decode(data)
    changed = bytearray(data)
    changed[at % len(data)] = byte
    for bad in (bytes(changed), data[: cut % len(data)], data + b"\0", data + b"\1"):
        assert outcome(codec.decode, bad) == outcome(decode_message, bad)


def test_same_outcome_over_the_mutated_corpus() -> None:
    corpus, chance, codec = valid_messages(), random.Random(5), Codec()
    for _ in range(3):
        for data in corpus:
            outcome(codec.decode, data)
    for _ in range(20_000):
        data = mutate(chance, corpus)
        assert outcome(codec.decode, data) == outcome(decode_message, data), data.hex()


@given(values=st.lists(fields(), min_size=1, max_size=20), header=st.tuples(UINT16, INT64, UINT32))
@settings(max_examples=300)
def test_writer_plan_encodes_as_the_generic_codec(values: list[Variant], header: tuple[int, int, int]) -> None:
    types = tuple(value.type for value in values)
    plan = Codec().writer_plan(2, 3, 1001, types, 8, 9)
    sequence_number, timestamp, status = header
    part = DataSetMessage(
        1001,
        types=types,
        values=tuple(value.value for value in values),
        sequence_number=sequence_number,
        timestamp=timestamp,
        status=status,
        major_version=8,
        minor_version=9,
    )
    expected = encode_message(NetworkMessage(2, writer_group_id=3, messages=(part,)))
    assert plan.encode(sequence_number, timestamp, status, part.values) == expected


OURS = DataSetMessage(
    1001, types=(11,), values=(1.5,), sequence_number=1, timestamp=2, status=0, major_version=3, minor_version=4
)


def ours(values: tuple[Variant, ...], **other: Any) -> NetworkMessage:
    types = tuple(value.type for value in values)
    part = OURS._replace(types=types, values=tuple(value.value for value in values), **other)
    return NetworkMessage(2, writer_group_id=2, messages=(part,))


def plans_of(codec: Codec) -> dict[bytes, Any]:
    return codec._plans  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    "values",
    [
        pytest.param(tuple(value for value in EVERY_TYPE), id="every type"),
        pytest.param((Variant(11, 1.5),), id="1x1"),
        pytest.param((Variant(11, 1.5),) * 50, id="1x50"),
        pytest.param((Variant(1, True), Variant(6, 5)) * (MOST_NAMED_FIELDS + 1), id="many with Booleans"),
        pytest.param((Variant(12, "a"), Variant(0x8B, (1.0,)), Variant(11, math.nan)), id="NaN behind variable parts"),
        pytest.param((Variant(12, "a"),), id="a String alone"),
        pytest.param((Variant(0x8C, ("a",)),), id="an array of Strings alone"),
        pytest.param((Variant(0x81, (True,)),), id="an array of Boolean alone"),
        pytest.param((Variant(3, 1),) * MOST_PLANNED_FIELDS, id="as many fields as are planned"),
    ],
)
def test_a_plan_is_at_work(values: tuple[Variant, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """From the third message on, the generic codec is not asked."""
    codec = Codec()
    message = ours(values)
    data = encode_message(message)
    expected = repr(decode_message(data))
    assert prefix_length(data) == 12
    for _ in range(2):
        codec.decode(data)
    codec.encode(message)
    assert list(plans_of(codec)) == [data[:12]]
    with monkeypatch.context() as patched:
        patched.setattr(codec_module, "decode_message", _not_asked)
        patched.setattr(codec_module, "encode_message", _not_asked)
        patched.setattr("ua_fleet.wire.encode_plan.encode_message", _not_asked)
        assert repr(codec.decode(data)) == expected
        assert codec.encode(message) == data


def _not_asked(_: object) -> Any:
    raise AssertionError("the generic codec was asked")


def test_a_plan_for_another_header() -> None:
    """A peer's message without WriterGroupId, DataSetFlags2 and versions is planned as well."""
    message = NetworkMessage(1 << 40, PublisherIdType.UINT64, messages=(DataSetMessage(1, types=(11,), values=(1.5,)),))
    codec, data = Codec(), encode_message(message)
    for _ in range(4):
        assert codec.decode(data) == message
    assert list(plans_of(codec)) == [data[:14]]


def test_null_strings_and_arrays_take_the_long_way() -> None:
    codec = Codec()
    full = ours((Variant(12, "a"), Variant(15, b"b"), Variant(0x8B, (1.0,)), Variant(3, 1)))
    null = ours((Variant(12, None), Variant(15, None), Variant(0x8B, None), Variant(3, 1)))
    for message in (full, full, full, null, null, null, full):
        data = encode_message(message)
        assert codec.decode(data) == message
        assert codec.encode(message) == data


def test_a_changed_layout_gets_a_new_plan() -> None:
    codec = Codec()
    for values in ((Variant(11, 1.5),), (Variant(12, "a"), Variant(6, 1)), (Variant(0x13, 5),)):
        message = ours(values)
        data = encode_message(message)
        for _ in range(4):
            assert codec.decode(data) == message
            assert codec.encode(message) == data
        assert len(plans_of(codec)) == 1


def test_a_changed_version_is_seen() -> None:
    codec = Codec()
    for major in (1, 2):
        message = ours((Variant(11, 1.5),), major_version=major)
        for _ in range(4):
            assert codec.decode(encode_message(message)) == message


def test_repeated_versions_do_not_mix_messages_up() -> None:
    """Two layouts of one writer in turn: each message comes out right, whatever plan there is."""
    codec = Codec()
    first, second = ours((Variant(11, 1.5),)), ours((Variant(12, "text"),))
    for message in (first, second) * 8:
        assert codec.decode(encode_message(message)) == message
        assert codec.encode(message) == encode_message(message)


def test_no_plan_for_padded_messages() -> None:
    codec = Codec()
    message = ours((Variant(11, 1.5),))
    for _ in range(4):
        assert codec.decode(encode_message(message) + bytes(3)) == message
    assert not plans_of(codec)


def test_a_datagram_that_ends_early_meets_a_plan() -> None:
    """Sizes far beyond the end do not confuse a plan: null, 4 GB, and an array of 4 G elements."""
    codec = Codec()
    message = ours((Variant(12, "abc"), Variant(0x8B, (1.0,)), Variant(15, b"x"), Variant(12, "z")))
    data = encode_message(message)
    for _ in range(3):
        codec.decode(data)
    for at in range(36, len(data) - 4):
        for length in (-1, -2, 0x7FFF_FFFF, 0, 2, 200):
            bad = data[:at] + struct.pack("<i", length) + data[at + 4 :]
            assert outcome(codec.decode, bad) == outcome(decode_message, bad)


def test_caches_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(codec_module, "MOST_PLANS", 3)
    codec = Codec()
    for writer in range(1, 9):
        message = ours((Variant(11, float(writer)),), data_set_writer_id=writer)
        for _ in range(3):
            assert codec.decode(encode_message(message)) == message
            assert codec.encode(message) == encode_message(message)
    assert len(plans_of(codec)) == 3


def test_a_peer_that_changes_its_fields_all_the_time_is_not_compiled_for() -> None:
    codec = Codec()
    chance = random.Random(1)
    for _ in range(600):
        message = ours(tuple(chance.choice((Variant(1, True), Variant(3, 7))) for _ in range(12)))
        for _ in range(2):
            assert codec.decode(encode_message(message)) == message
    compiled = len(codec._layouts)  # pyright: ignore[reportPrivateUsage]
    assert compiled <= (codec_module.FULL_CREDIT + 2 * 600) // codec_module.COST_OF_A_LAYOUT + 1


BAD: list[tuple[tuple[int, ...], tuple[Any, ...]]] = [
    ((11,), ()),
    ((11,), (1.0, 2.0)),
    ((11,), ("1.5",)),
    ((11,), (None,)),
    ((11, 1), (1.0, 1)),
    ((1,) * 20, (True,) * 19 + (1,)),
    ((11,) * 20, (1.0,) * 19),
    ((6,), (1 << 31,)),
    ((6,), (1.5,)),
    ((10,), (1e300,)),
    ((12,), (5,)),
    ((12,), (b"a",)),
    ((12,), ("\ud800",)),
    ((3, 15), (1, "a")),
    ((3, 0x8B), (1, 1.5)),
    ((3, 0x8B), (1, (1.0, "a"))),
    ((3, 0x83), (1, b"a")),
    ((3, 0x81), (1, (1,))),
    ((3, 0x8C), (1, ("a", 5))),
    ((3, 22), (1, b"")),
]


@pytest.mark.parametrize(("types", "values"), BAD)
def test_values_that_do_not_fit_are_refused(types: tuple[int, ...], values: tuple[Any, ...]) -> None:
    plan = Codec().writer_plan(2, 2, 1001, types, 1, 2)
    with pytest.raises(LocalWireError):
        plan.encode(1, 2, 0, values)


@pytest.mark.parametrize(
    "header", [(70_000, 2, 0), (-1, 2, 0), (1, 1 << 63, 0), (1, 2, -1), (1, 2, 1 << 32), (1, None, 0)]
)
def test_headers_that_do_not_fit_are_refused(header: tuple[int, int, int]) -> None:
    plan = Codec().writer_plan(2, 2, 1001, (11,), 1, 2)
    with pytest.raises(LocalWireError):
        plan.encode(*header, (1.5,))


@pytest.mark.parametrize(
    ("ids", "types"), [((70_000, 2, 9), (11,)), ((2, -1, 9), (11,)), ((2, 2, 70_000), (11,)), ((2, 2, 9), (99,))]
)
def test_writers_that_cannot_be(ids: tuple[int, int, int], types: tuple[int, ...]) -> None:
    with pytest.raises(LocalWireError):
        WriterPlan(*ids, types, 1, 2).encode(1, 2, 0, (1.5,) * len(types))


def test_a_writer_without_fields_sends_heartbeats() -> None:
    plan = Codec().writer_plan(2, 2, 1001, (), 1, 2)
    decoded = decode_message(plan.encode(1, 2, 0, ()))
    assert isinstance(decoded, NetworkMessage)
    assert decoded.messages[0].kind == FrameKind.KEY
    assert decoded.messages[0].types == ()


def test_a_wide_writer_is_encoded_without_a_plan() -> None:
    types = (14,) + (3,) * MOST_PLANNED_FIELDS
    plan = Codec().writer_plan(2, 2, 1001, types, 1, 2)
    values = (UUID(int=1), *range(MOST_PLANNED_FIELDS))
    decoded = decode_message(plan.encode(1, 2, 0, values))
    assert isinstance(decoded, NetworkMessage)
    assert decoded.messages[0].values == values
