"""Values as bytes: one table of (name, value, bytes), run in both directions.

The bytes are worked out from OPC 10000-6 5.2.2; what it has as an example is in it.
"""

from __future__ import annotations

import math
import struct
from typing import Any
from uuid import UUID

import pytest

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    DataValue,
    DiagnosticInfo,
    ExpandedNodeId,
    ExtensionObject,
    LocalizedText,
    Matrix,
    NodeId,
    QualifiedName,
    Variant,
)
from ua_fleet.wire.causes import Cause
from ua_fleet.wire.cursor import DEEPEST_NESTING, Cursor
from ua_fleet.wire.variant import decode_variant, encode_variant

GUID = UUID("72962b91-fa75-4ae6-8d28-b404dc7daf63")
"""The example of OPC 10000-6 5.2.2.6."""
GUID_HEX = "912b9672 75fa e64a 8d28b404dc7daf63"

TABLE: list[tuple[str, Variant, str]] = [
    ("null", Variant(0, None), "00"),
    ("Boolean true", Variant(1, True), "01 01"),
    ("Boolean false", Variant(1, False), "01 00"),
    ("SByte", Variant(2, -2), "02 fe"),
    ("Byte", Variant(3, 200), "03 c8"),
    ("Int16", Variant(4, -300), "04 d4fe"),
    ("UInt16", Variant(5, 0xABCD), "05 cdab"),
    ("Int32", Variant(6, 1_000_000_000), "06 00ca9a3b"),
    ("UInt32", Variant(7, 0xFFFFFFFF), "07 ffffffff"),
    ("Int64", Variant(8, -1), "08 ffffffffffffffff"),
    ("UInt64", Variant(9, 1 << 63), "09 0000000000000080"),
    ("Float, the example of 5.2.2.3", Variant(10, -6.5), "0a 0000d0c0"),
    ("Double", Variant(11, -6.5), "0b 0000000000001ac0"),
    ("Double infinity", Variant(11, math.inf), "0b 000000000000f07f"),
    ("String, the example of 5.2.2.4", Variant(12, "水Boy"), "0c 06000000 e6b0b4426f79"),
    ("String empty", Variant(12, ""), "0c 00000000"),
    ("String null", Variant(12, None), "0c ffffffff"),
    ("String with a zero", Variant(12, "a\0b"), "0c 03000000 610062"),
    ("DateTime", Variant(13, 133_500_000_000_000_000), "0d 00c083ed8a49da01"),
    ("DateTime before 1601", Variant(13, -1), "0d ffffffffffffffff"),
    ("Guid", Variant(14, GUID), "0e" + GUID_HEX),
    ("ByteString", Variant(15, b"\x01\xff"), "0f 02000000 01ff"),
    ("ByteString null", Variant(15, None), "0f ffffffff"),
    ("XmlElement", Variant(16, "<a/>"), "10 04000000 3c612f3e"),
    ("NodeId two byte", Variant(17, NodeId(0, 72)), "11 00 48"),
    ("NodeId four byte, the example of 5.2.2.9", Variant(17, NodeId(5, 1025)), "11 01 05 0104"),
    ("NodeId four byte, small", Variant(17, NodeId(1, 1)), "11 01 01 0100"),
    ("NodeId numeric", Variant(17, NodeId(0x1234, 5)), "11 02 3412 05000000"),
    ("NodeId numeric, large", Variant(17, NodeId(0, 0x10000)), "11 02 0000 00000100"),
    ("NodeId string, the example of 5.2.2.9", Variant(17, NodeId(1, "Hot水")), "11 03 0100 06000000 486f74e6b0b4"),
    ("NodeId guid", Variant(17, NodeId(2, GUID)), "11 04 0200" + GUID_HEX),
    ("NodeId opaque", Variant(17, NodeId(2, b"\x07")), "11 05 0200 01000000 07"),
    ("ExpandedNodeId", Variant(18, ExpandedNodeId(NodeId(0, 9))), "12 00 09"),
    (
        "ExpandedNodeId with everything",
        Variant(18, ExpandedNodeId(NodeId(0, "x"), "u:n", 3)),
        "12 c3 0000 01000000 78 03000000 753a6e 03000000",
    ),
    ("StatusCode", Variant(19, 0x8031_0000), "13 00003180"),
    ("QualifiedName", Variant(20, QualifiedName(2, "a")), "14 0200 01000000 61"),
    ("QualifiedName null", Variant(20, QualifiedName(0, None)), "14 0000 ffffffff"),
    ("LocalizedText", Variant(21, LocalizedText("a", "en")), "15 03 02000000 656e 01000000 61"),
    ("LocalizedText text only", Variant(21, LocalizedText("a")), "15 02 01000000 61"),
    ("LocalizedText null", Variant(21, LocalizedText(None)), "15 00"),
    ("ExtensionObject without body", Variant(22, ExtensionObject(NodeId(0, 5), None)), "16 00 05 00"),
    ("ExtensionObject", Variant(22, ExtensionObject(NodeId(0, 5), b"\x01")), "16 00 05 01 01000000 01"),
    ("ExtensionObject XML", Variant(22, ExtensionObject(NodeId(0, 5), "<")), "16 00 05 02 01000000 3c"),
    ("DataValue empty", Variant(23, DataValue(None)), "17 00"),
    (
        "DataValue full",
        Variant(23, DataValue(Variant(3, 7), 0x4000_0000, 2, 3, 4, 5)),
        "17 3f 03 07 00000040 0200000000000000 0400 0300000000000000 0500",
    ),
    ("DiagnosticInfo empty", Variant(25, DiagnosticInfo()), "19 00"),
    (
        "DiagnosticInfo full: the locale precedes the text",
        Variant(25, DiagnosticInfo(1, 2, 3, 4, "i", 0x8000_0000, DiagnosticInfo(symbolic_id=-1))),
        "19 7f 01000000 02000000 04000000 03000000 01000000 69 00000080 01 ffffffff",
    ),
    ("array of Boolean", Variant(0x81, (True, False)), "81 02000000 01 00"),
    ("array of Double", Variant(0x8B, (1.5, -0.0)), "8b 02000000 000000000000f83f 0000000000000080"),
    ("array empty", Variant(0x86, ()), "86 00000000"),
    ("array null", Variant(0x86, None), "86 ffffffff"),
    ("array of String", Variant(0x8C, ("a", None)), "8c 02000000 01000000 61 ffffffff"),
    ("array of Guid", Variant(0x8E, (GUID,)), "8e 01000000" + GUID_HEX),
    ("array of NodeId", Variant(0x91, (NodeId(0, 1), NodeId(0, 2))), "91 02000000 0001 0002"),
    ("array of Variant", Variant(0x98, (Variant(3, 1), Variant(0x83, (2,)))), "98 02000000 03 01 83 01000000 02"),
    ("array of DataValue", Variant(0x97, (DataValue(Variant(1, True)),)), "97 01000000 01 01 01"),
    (
        "matrix, higher dimensions first",
        Variant(0xC3, Matrix((1, 2, 3, 4, 5, 6), (2, 3))),
        "c3 06000000 010203040506 02000000 02000000 03000000",
    ),
    (
        "matrix of String",
        Variant(0xCC, Matrix(("a", "b"), (2, 1))),
        "cc 02000000 01000000 61 01000000 62 02000000 02000000 01000000",
    ),
]

ALL = pytest.mark.parametrize(("value", "encoded"), [pytest.param(*row[1:], id=row[0]) for row in TABLE])


@ALL
def test_decodes(value: Variant, encoded: str) -> None:
    cursor = Cursor(bytes.fromhex(encoded))
    assert decode_variant(cursor) == value
    assert cursor.remaining == 0


@ALL
def test_encodes(value: Variant, encoded: str) -> None:
    out = bytearray()
    encode_variant(out, value)
    assert out == bytes.fromhex(encoded)


@ALL
def test_every_truncation_is_refused(value: Variant, encoded: str) -> None:
    data = bytes.fromhex(encoded)
    for size in range(len(data)):
        with pytest.raises(RemoteWireError):
            decode_variant(Cursor(data[:size]))


def test_table_has_every_type() -> None:
    scalars = {value.type for _, value, _ in TABLE if not value.type & ARRAY}
    assert scalars == set(range(26)) - {24}  # a scalar Variant may not stand in a Variant


def test_nan_survives() -> None:
    out = bytearray()
    encode_variant(out, Variant(0x8A, (math.nan, 1.0)))
    values = decode_variant(Cursor(bytes(out))).value
    assert math.isnan(values[0])
    assert values[1] == 1.0


@pytest.mark.parametrize("kind", range(26, 32))
def test_unassigned_types_are_byte_strings(kind: int) -> None:
    """OPC 10000-6 table 26: decoders shall accept these ids and pass them on, encoders shall not use them."""
    assert decode_variant(Cursor(bytes([kind, 1, 0, 0, 0, 7]))) == Variant(kind, b"\x07")
    array = bytes([kind | ARRAY, 1, 0, 0, 0, 1, 0, 0, 0, 7])
    assert decode_variant(Cursor(array)) == Variant(kind | ARRAY, (b"\x07",))
    with pytest.raises(LocalWireError):
        encode_variant(bytearray(), Variant(kind, b"\x07"))


def test_any_nonzero_byte_is_true() -> None:
    assert decode_variant(Cursor(b"\x01\x07")) == Variant(1, True)


def test_null_identifiers_are_empty() -> None:
    assert decode_variant(Cursor(bytes.fromhex("11 03 0100 ffffffff"))).value == NodeId(1, "")
    assert decode_variant(Cursor(bytes.fromhex("11 05 0100 ffffffff"))).value == NodeId(1, b"")


@pytest.mark.parametrize(
    ("matrix", "encoded"),
    [
        pytest.param(Matrix((), (0, 3)), "83 00000000", id="no elements"),
        pytest.param(Matrix((1, 2), (2,)), "83 02000000 0102", id="one dimension"),
    ],
)
def test_dimensions_that_may_not_be_sent(matrix: Matrix, encoded: str) -> None:
    """OPC 10000-6 5.2.2.16: ArrayDimensions only with two dimensions or more, all of them above 0."""
    out = bytearray()
    encode_variant(out, Variant(0xC3, matrix))
    assert out == bytes.fromhex(encoded)


def test_empty_matrices_are_read() -> None:
    data = bytes.fromhex("c3 00000000 02000000 00000000 03000000")
    assert decode_variant(Cursor(data)).value == Matrix((), (0, 3))
    assert decode_variant(Cursor(bytes.fromhex("c3 ffffffff ffffffff"))).value == Matrix((), ())


def test_a_product_of_many_dimensions_is_not_worked_out() -> None:
    dimensions = struct.pack("<i15000i", 15_000, *[0x7FFF_FFFF] * 15_000)
    with pytest.raises(RemoteWireError) as caught:
        decode_variant(Cursor(bytes.fromhex("c3 01000000 07") + dimensions))
    assert caught.value.cause == Cause.ARRAY_DIMENSIONS


def _nested_variants(levels: int) -> Variant:
    value = Variant(3, 1)
    for _ in range(levels):
        value = Variant(0x98, (value,))
    return value


def test_nesting_has_an_end() -> None:
    out = bytearray()
    encode_variant(out, _nested_variants(DEEPEST_NESTING))
    assert decode_variant(Cursor(bytes(out))) == _nested_variants(DEEPEST_NESTING)
    with pytest.raises(LocalWireError):
        encode_variant(bytearray(), _nested_variants(DEEPEST_NESTING + 1))
    for opening in (bytes.fromhex("98 01000000"), bytes.fromhex("17 01"), bytes.fromhex("19") + b"\x40"):
        data = bytes.fromhex("9801000000") * DEEPEST_NESTING + opening * 100_000
        with pytest.raises(RemoteWireError) as caught:
            decode_variant(Cursor(data))
        assert caught.value.cause == Cause.TOO_DEEP


@pytest.mark.parametrize("prefix", ["0c", "0f", "8c", "83", "98", "16 00 05 01"])
def test_announced_gigabytes_are_not_allocated(prefix: str) -> None:
    with pytest.raises(RemoteWireError) as caught:
        decode_variant(Cursor(bytes.fromhex(prefix) + b"\xff\xff\xff\x7f" + bytes(40)))
    assert caught.value.cause == Cause.LENGTH_BEYOND_END


BAD_VALUES: list[tuple[int, Any]] = [
    (0, 1),
    (1, 1),
    (1, None),
    (1, "true"),
    (2, 128),
    (3, -1),
    (3, 256),
    (4, 40_000),
    (5, 1.0),
    (6, "1"),
    (7, -1),
    (8, 1 << 63),
    (9, -1),
    (10, 1e300),
    (10, "1"),
    (11, None),
    (11, "1"),
    (12, 5),
    (12, b"bytes"),
    (12, "\ud800"),
    (13, None),
    (14, "72962b91-fa75-4ae6-8d28-b404dc7daf63"),
    (15, "text"),
    (15, 5),
    (16, 5),
    (17, 5),
    (17, NodeId(0, -1)),
    (17, NodeId(0, 1 << 32)),
    (17, NodeId(70_000, 1)),
    (18, NodeId(0, 1)),
    (18, ExpandedNodeId(NodeId(0, 1), None, 1 << 32)),
    (19, -1),
    (20, "name"),
    (20, QualifiedName(-1, "a")),
    (21, "text"),
    (21, LocalizedText(5)),  # type: ignore[arg-type]
    (22, b"body"),
    (23, 1.5),
    (23, DataValue(5)),  # type: ignore[arg-type]
    (24, Variant(3, 1)),
    (25, "info"),
    (26, b""),
    (64, None),
    (256, None),
    (DIMENSIONS | 3, 1),
    (ARRAY, ()),
    (ARRAY | 1, (1,)),
    (ARRAY | 3, (256,)),
    (ARRAY | 3, b"\1"),
    (ARRAY | 10, (1e300,)),
    (ARRAY | 11, 1.5),
    (ARRAY | 12, "text"),
    (ARRAY | 12, ("a", 5)),
    (ARRAY | 24, (5,)),
    (ARRAY | DIMENSIONS | 3, (1,)),
    (ARRAY | DIMENSIONS | 3, Matrix((1, 2, 3), (2, 2))),
    (ARRAY | DIMENSIONS | 3, Matrix((1, 2), (-1, -2))),
]


@pytest.mark.parametrize(("code", "value"), BAD_VALUES)
def test_values_that_do_not_fit_are_our_mistake(code: int, value: Any) -> None:
    with pytest.raises(LocalWireError):
        encode_variant(bytearray(), Variant(code, value))
