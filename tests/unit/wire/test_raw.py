"""RawData fields: OPC 10000-14 7.2.4.5.11, padded to the maxima of the metadata."""

from __future__ import annotations

from typing import Any
from uuid import UUID

import pytest

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import Matrix
from ua_fleet.wire import Cause, decode_raw_fields
from ua_fleet.wire.messages import (
    ConfigurationVersion,
    DataSetMessage,
    DataSetMetaData,
    FieldEncoding,
    FieldMetaData,
    FrameKind,
)
from ua_fleet.wire.raw import encode_raw_field

RAW = DataSetMessage(1, encoding=FieldEncoding.RAW_DATA)


def metadata(*fields: FieldMetaData) -> DataSetMetaData:
    return DataSetMetaData("raw", fields, ConfigurationVersion(1, 1))


def field(builtin_type: int, **other: Any) -> FieldMetaData:
    return FieldMetaData("f", builtin_type)._replace(**other)


TABLE: list[tuple[str, FieldMetaData, int, Any, str]] = [
    ("Boolean", field(1), 1, True, "01"),
    ("SByte", field(2), 2, -1, "ff"),
    ("UInt64", field(9), 9, 1, "0100000000000000"),
    ("Float", field(10), 10, 1.0, "0000803f"),
    ("DateTime", field(13), 13, 1, "0100000000000000"),
    ("StatusCode", field(19), 19, 0x8000_0000, "00000080"),
    (
        "Guid",
        field(14),
        14,
        UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63"),
        "912b9672 75fa e64a 8d28b404dc7daf63",
    ),
    ("String without a maximum", field(12), 12, "ab", "02000000 6162"),
    ("String padded", field(12, max_string_length=4), 12, "ab", "02000000 6162 0000"),
    ("String full", field(12, max_string_length=2), 12, "ab", "02000000 6162"),
    ("String null padded", field(12, max_string_length=2), 12, None, "ffffffff 0000"),
    ("ByteString padded", field(15, max_string_length=3), 15, b"\x07", "01000000 07 0000"),
    ("array", field(3, value_rank=1), 0x83, (1, 2), "02000000 0102"),
    ("array padded", field(5, value_rank=1, array_dimensions=(3,)), 0x85, (1,), "01000000 0100 0000 0000"),
    ("array of unknown maximum", field(3, value_rank=1, array_dimensions=(0,)), 0x83, (1,), "01000000 01"),
    ("array null padded", field(3, value_rank=1, array_dimensions=(2,)), 0x83, None, "ffffffff 0000"),
    (
        "array of Strings, both padded",
        field(12, value_rank=1, array_dimensions=(2,), max_string_length=2),
        0x8C,
        ("a",),
        "01000000 01000000 6100 00000000 0000",
    ),
    (
        "matrix: dimensions, then rows",
        field(3, value_rank=2),
        0xC3,
        Matrix((1, 2, 3, 4, 5, 6), (2, 3)),
        "02000000 02000000 03000000 010203 040506",
    ),
    (
        "matrix padded in each dimension",
        field(3, value_rank=2, array_dimensions=(3, 4)),
        0xC3,
        Matrix((1, 2, 3, 4), (2, 2)),
        "02000000 02000000 02000000 01020000 03040000 00000000",
    ),
    (
        "matrix without elements, padded",
        field(3, value_rank=2, array_dimensions=(1, 2)),
        0xC3,
        Matrix((), (0, 2)),
        "02000000 00000000 02000000 0000",
    ),
    (
        "matrix whose maxima do not fit its rank",
        field(3, value_rank=2, array_dimensions=(3,)),
        0xC3,
        Matrix((1, 2), (1, 2)),
        "02000000 01000000 02000000 0102",
    ),
    (
        "cube",
        field(3, value_rank=3, array_dimensions=(1, 2, 2)),
        0xC3,
        Matrix((1, 2), (1, 2, 1)),
        "03000000 01000000 02000000 01000000 0100 0200",
    ),
]


@pytest.mark.parametrize(("of", "code", "value", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in TABLE])
def test_fields(of: FieldMetaData, code: int, value: Any, encoded: str) -> None:
    data = bytes.fromhex(encoded)
    byte = field(3)
    message = RAW._replace(raw=b"\x07" + data + b"\x08\0\0")  # with padding up to a ConfiguredSize
    decoded = decode_raw_fields(message, metadata(byte, of, byte))
    assert decoded == message._replace(types=(3, code, 3), values=(7, value, 8), raw=None)
    assert encode_raw_field(of, value).hex(" ") == data.hex(" ")
    for size in range(len(data)):
        with pytest.raises(RemoteWireError):
            decode_raw_fields(RAW._replace(raw=data[:size]), metadata(of))


def test_a_delta_frame_has_indices() -> None:
    message = RAW._replace(kind=FrameKind.DELTA, raw=bytes.fromhex("0200 0200 05 0000 0600"))
    decoded = decode_raw_fields(message, metadata(field(5), field(12), field(3)))
    assert (decoded.indices, decoded.types, decoded.values) == ((2, 0), (3, 5), (5, 6))


def test_other_messages_are_returned_as_they_are() -> None:
    message = DataSetMessage(1, types=(3,), values=(7,))
    assert decode_raw_fields(message, metadata()) is message


REFUSED: list[tuple[str, Cause, FieldMetaData, str]] = [
    *[(f"type {kind}", Cause.RAW_TYPE, field(kind), "00" * 40) for kind in (0, 16, 17, 18, 20, 21, 22, 23, 24, 25, 26)],
    *[(f"rank {rank}", Cause.RAW_RANK, field(3, value_rank=rank), "00" * 40) for rank in (-3, -2, 0, 17)],
    ("long String", Cause.RAW_TOO_LONG, field(12, max_string_length=1), "02000000 6162"),
    ("long array", Cause.RAW_TOO_LONG, field(3, value_rank=1, array_dimensions=(1,)), "02000000 0102"),
    (
        "large matrix",
        Cause.RAW_TOO_LONG,
        field(3, value_rank=2, array_dimensions=(1, 1)),
        "02000000 01000000 02000000 0102",
    ),
    ("padding", Cause.RAW_PADDING, field(12, max_string_length=3), "02000000 616263"),
    ("rank of the matrix", Cause.ARRAY_DIMENSIONS, field(3, value_rank=2), "01000000 01000000 01"),
    ("negative dimension", Cause.ARRAY_DIMENSIONS, field(3, value_rank=2), "02000000 ffffffff 01000000"),
    ("endless matrix", Cause.TRUNCATED, field(3, value_rank=2), "02000000 ffffff7f ffffff7f 00"),
    ("UTF-8", Cause.INVALID_UTF8, field(12), "01000000 ff"),
    ("what follows", Cause.TRAILING_BYTES, field(3), "07 08"),
]


@pytest.mark.parametrize(("cause", "of", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in REFUSED])
def test_refused(cause: Cause, of: FieldMetaData, encoded: str) -> None:
    with pytest.raises(RemoteWireError) as caught:
        decode_raw_fields(RAW._replace(raw=bytes.fromhex(encoded)), metadata(of))
    assert caught.value.cause == cause


def test_a_dimension_of_zero_ends_the_others() -> None:
    """2**31 empty rows are not walked through."""
    data = bytes.fromhex("02000000 ffffff7f 00000000")
    decoded = decode_raw_fields(RAW._replace(raw=data), metadata(field(3, value_rank=2)))
    assert decoded.values == (Matrix((), (0x7FFF_FFFF, 0)),)


@pytest.mark.parametrize("index", ["0300", "0000 05 0000"])
def test_delta_indices_are_checked(index: str) -> None:
    message = RAW._replace(kind=FrameKind.DELTA, raw=bytes.fromhex(f"0200 {index} 05"))
    with pytest.raises(RemoteWireError) as caught:
        decode_raw_fields(message, metadata(field(3), field(3), field(3)))
    assert caught.value.cause == Cause.RAW_FIELD_INDEX


UNSENDABLE: list[tuple[str, FieldMetaData, Any]] = [
    *[(f"type {kind}", field(kind), None) for kind in (0, 16, 17, 18, 20, 21, 22, 23, 24, 25, 26)],
    *[(f"rank {rank}", field(3, value_rank=rank), ()) for rank in (-3, -2, 0, 17)],
    ("another type", field(12), 7),
    ("a number out of range", field(3), 256),
    ("long String", field(12, max_string_length=1), "ab"),
    ("no array", field(3, value_rank=1), 7),
    ("long array", field(3, value_rank=1, array_dimensions=(1,)), (1, 2)),
    ("no matrix", field(3, value_rank=2), (1, 2)),
    ("rank of the matrix", field(3, value_rank=2), Matrix((1,), (1,))),
    ("elements of the matrix", field(3, value_rank=2), Matrix((1,), (1, 2))),
    ("large matrix", field(3, value_rank=2, array_dimensions=(1, 1)), Matrix((1, 2), (1, 2))),
]


@pytest.mark.parametrize(("of", "value"), [pytest.param(*row[1:], id=row[0]) for row in UNSENDABLE])
def test_what_cannot_be_sent(of: FieldMetaData, value: Any) -> None:
    with pytest.raises(LocalWireError):
        encode_raw_field(of, value)


def test_a_view_of_numbers_is_sent_as_it_is() -> None:
    view = memoryview(bytes.fromhex("0000003f0000c03f")).cast("f")
    assert encode_raw_field(field(10, value_rank=1), view).hex() == "020000000000003f0000c03f"
