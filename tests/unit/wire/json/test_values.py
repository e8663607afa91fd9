"""Built-in types, arrays and Variants as JSON: vectors in both directions, the older forms, and what is refused."""

from __future__ import annotations

import math
from typing import Any

import pytest

from tests.unit.wire.json.vectors import GUID, NAMESPACES, SCALARS, VARIANTS
from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import (
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
from ua_fleet.wire.cursor import DEEPEST_NESTING
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.parsing import DEFAULT_LIMITS, Limits, Reading, dump, parse
from ua_fleet.wire.json.variants import (
    Writing,
    decode_data_value,
    decode_element,
    decode_value,
    decode_variant,
    encode_element,
    encode_variant,
)
from ua_fleet.wire.variant import encode_typed

VERBOSE = Writing(NAMESPACES, verbose=True)
COMPACT = Writing(NAMESPACES, verbose=False)


@pytest.mark.parametrize(("kind", "value", "text"), SCALARS)
def test_scalars_both_ways(kind: int, value: Any, text: Any) -> None:
    assert encode_element(VERBOSE, kind, value) == text
    reading = Reading(NAMESPACES)
    assert decode_element(reading, kind, text) == value
    assert not reading.leniencies


@pytest.mark.parametrize(("variant", "text"), VARIANTS)
def test_variants_both_ways(variant: Variant, text: Any) -> None:
    assert encode_variant(VERBOSE, variant) == text
    reading = Reading(NAMESPACES)
    assert decode_variant(reading, text) == variant
    assert not reading.leniencies


def test_nan_is_a_text() -> None:
    assert encode_element(VERBOSE, 11, math.nan) == "NaN"
    assert math.isnan(decode_element(Reading(), 11, "NaN"))


def test_symbols_belong_to_the_verbose_encoding() -> None:
    assert encode_element(COMPACT, 19, 0x8031_0000) == {"Code": 0x8031_0000}


def test_a_float_is_the_nearest_that_32_bits_hold() -> None:
    assert decode_element(Reading(), 10, 0.1) == 0.10000000149011612


OLD: list[tuple[int, Any, Any, Leniency]] = [
    (17, {"Id": 13}, NodeId(0, 13), Leniency.OLD_NODE_ID),
    (17, {"IdType": 1, "Id": "robot", "Namespace": 2}, NodeId(2, "robot"), Leniency.OLD_NODE_ID),
    (17, {"IdType": 2, "Id": str(GUID), "Namespace": "urn:fleet"}, NodeId(1, GUID), Leniency.OLD_NODE_ID),
    (17, {"IdType": 3, "Id": "AQ==", "Namespace": 1}, NodeId(1, b"\1"), Leniency.OLD_NODE_ID),
    (
        18,
        {"Id": 7, "Namespace": "urn:x", "ServerUri": 3},
        ExpandedNodeId(NodeId(0, 7), "urn:x", 3),
        Leniency.OLD_NODE_ID,
    ),
    (19, 0x8031_0000, 0x8031_0000, Leniency.OLD_STATUS_CODE),
    (19, None, 0, Leniency.OLD_STATUS_CODE),
    (20, {"Name": "Speed", "Uri": 2}, QualifiedName(2, "Speed"), Leniency.OLD_QUALIFIED_NAME),
    (20, {"Name": "Speed", "Uri": "urn:fleet"}, QualifiedName(1, "Speed"), Leniency.OLD_QUALIFIED_NAME),
    (21, "text", LocalizedText("text"), Leniency.OLD_LOCALIZED_TEXT),
    (
        22,
        {"TypeId": {"Id": 5}, "Encoding": 1, "Body": "Ym9keQ=="},
        ExtensionObject(NodeId(0, 5), b"body"),
        Leniency.OLD_EXTENSION_OBJECT,
    ),
    (
        22,
        {"TypeId": {"Id": 5}, "Encoding": 2, "Body": "<a/>"},
        ExtensionObject(NodeId(0, 5), "<a/>"),
        Leniency.OLD_EXTENSION_OBJECT,
    ),
    (5, "7", 7, Leniency.NUMBER_AS_TEXT),
    (5, 7.0, 7, Leniency.INTEGER_AS_FLOAT),
    (8, 7, 7, Leniency.INT64_AS_NUMBER),
    (11, "1.5e3", 1500.0, Leniency.NUMBER_AS_TEXT),
    (11, "-INF", -math.inf, Leniency.INFINITY_NAME),
    (6, None, 0, Leniency.NULL_NUMBER),
    (1, 1, True, Leniency.BOOLEAN_AS_NUMBER),
    (13, "2024-01-17T21:20:00", 133_500_000_000_000_000, Leniency.DATE_FORM),
    (13, "2024-01-17 23:20:00.00+02:00", 133_500_000_000_000_000, Leniency.DATE_FORM),
    (13, "2024-01-17T21:19:60Z", 133_500_000_000_000_000 - 10_000_000, Leniency.DATE_FORM),
    (14, "{" + str(GUID) + "}", GUID, Leniency.GUID_FORM),
    (15, "AP8", b"\0\xff", Leniency.BASE64_FORM),
    (15, "_-8=", b"\xff\xef", Leniency.BASE64_FORM),
    (17, "nsu=urn:nobody;i=7", NodeId(0, "nsu=urn:nobody;i=7"), Leniency.NAMESPACE_UNKNOWN),
    (20, "nsu=urn:nobody;x", QualifiedName(0, "nsu=urn:nobody;x"), Leniency.NAMESPACE_UNKNOWN),
]


@pytest.mark.parametrize(("kind", "text", "value", "leniency"), OLD)
def test_what_is_forgiven_is_counted_by_name(kind: int, text: Any, value: Any, leniency: Leniency) -> None:
    reading = Reading(NAMESPACES)
    assert decode_element(reading, kind, text) == value
    assert leniency in reading.leniencies


def test_digits_beyond_100_ns_are_cut_off_without_a_word() -> None:
    reading = Reading()
    assert decode_element(reading, 13, "2024-01-17T21:20:00.12Z") == 133_500_000_001_200_000
    assert decode_element(reading, 13, "2024-01-17T21:20:00.123456789Z") == 133_500_000_001_234_567
    assert not reading.leniencies


def test_the_variant_and_data_value_of_the_older_form() -> None:
    reading = Reading()
    assert decode_variant(reading, {"Type": 6, "Body": [1, 2]}) == Variant(0x86, (1, 2))
    old = {"Value": {"Type": 11, "Body": 1.5}, "Status": 0x8031_0000, "SourcePicoSeconds": 7}
    assert decode_data_value(reading, old) == DataValue(Variant(11, 1.5), 0x8031_0000, source_picoseconds=7)
    assert set(reading.leniencies) == {Leniency.OLD_VARIANT, Leniency.OLD_STATUS_CODE, Leniency.OLD_PICOSECONDS}


def test_what_ua_net_standard_leaves_out_and_calls_otherwise() -> None:
    """Its Compact form has no Value where that is the default of its type, and its DataValues had a `StatusCode`."""
    reading = Reading()
    assert decode_variant(reading, {"UaType": 11}) == Variant(11, 0.0)
    assert decode_variant(reading, {"UaType": 19}) == Variant(19, 0)
    assert not reading.leniencies
    value = {"UaType": 7, "Value": 12345678, "StatusCode": {"Code": 2157772800, "Symbol": "BadDataLost"}}
    assert decode_data_value(reading, value) == DataValue(Variant(7, 12345678), 2157772800)
    assert reading.leniencies == {Leniency.STATUS_CODE_MEMBER: 1}


def test_null_for_what_has_no_null() -> None:
    """node-opcua writes infinities so."""
    reading = Reading()
    nothing = decode_variant(reading, {"UaType": 11, "Value": None})
    assert nothing.type == 11
    assert math.isnan(nothing.value)
    assert reading.leniencies == {Leniency.NULL_NUMBER: 1}
    assert decode_variant(reading, {"UaType": 6, "Value": None}) == Variant(0, None)
    assert encode_variant(VERBOSE, Variant(0x8B, None)) == {"UaType": 11, "Value": []}


def test_matrices_in_three_forms() -> None:
    matrix = Matrix((1, 2, 3, 4), (2, 2))
    reading = Reading()
    assert decode_value(reading, 6, {"Array": [1, 2, 3, 4], "Dimensions": [2, 2]}) == (0xC6, matrix)
    assert decode_value(reading, 6, [1, 2, 3, 4], [2, 2]) == (0xC6, matrix)
    assert not reading.leniencies
    assert decode_value(reading, 6, [[1, 2], [3, 4]]) == (0xC6, matrix)
    assert reading.leniencies == {Leniency.OLD_MATRIX: 1}
    node_opcua = {"UaType": 6, "Value": [1, 2, 3, 4], "UaDimensions": [2, 2]}
    assert decode_variant(reading, node_opcua) == Variant(0xC6, matrix)
    assert reading.leniencies == {Leniency.OLD_MATRIX: 1, Leniency.UA_DIMENSIONS: 1}


WRONG: list[tuple[int, Any, JsonCause]] = [
    (1, "true", JsonCause.VALUE_TYPE),
    (2, 128, JsonCause.VALUE_RANGE),
    (3, -1, JsonCause.VALUE_RANGE),
    (5, True, JsonCause.VALUE_TYPE),
    (5, 7.5, JsonCause.VALUE_RANGE),
    (6, "1_000", JsonCause.VALUE_TEXT),
    (6, "\u0661", JsonCause.VALUE_TEXT),
    (7, -1, JsonCause.VALUE_RANGE),
    (8, "9223372036854775808", JsonCause.VALUE_RANGE),
    (8, " 1", JsonCause.VALUE_TEXT),
    (9, 1.8446744073709552e19, JsonCause.VALUE_RANGE),  # what orjson makes of 2**64
    (9, "-1", JsonCause.VALUE_RANGE),
    (10, 1e39, JsonCause.VALUE_RANGE),
    (11, "1e999", JsonCause.VALUE_RANGE),
    (11, "fast", JsonCause.VALUE_TEXT),
    (11, [], JsonCause.VALUE_TYPE),
    (12, 5, JsonCause.VALUE_TYPE),
    (13, "2024-13-17T21:20:00Z", JsonCause.VALUE_TEXT),
    (13, "yesterday", JsonCause.VALUE_TEXT),
    (13, 5, JsonCause.VALUE_TYPE),
    (14, "72962b91", JsonCause.VALUE_TEXT),
    (15, "A", JsonCause.VALUE_TEXT),
    (15, "AP8=AP8=", JsonCause.VALUE_TEXT),
    (17, "x=7", JsonCause.VALUE_TEXT),
    (17, "i=4294967296", JsonCause.VALUE_TEXT),
    (17, "ns=65536;i=7", JsonCause.VALUE_RANGE),
    (17, "svr=1;i=7", JsonCause.VALUE_TEXT),
    (17, {"IdType": 9, "Id": 1}, JsonCause.VALUE_TYPE),
    (17, 7, JsonCause.VALUE_TYPE),
    (19, {"Code": 2**32}, JsonCause.VALUE_RANGE),
    (19, {"Symbol": "Nonsense"}, JsonCause.VALUE_TEXT),
    (19, "Bad", JsonCause.VALUE_TYPE),
    (20, 7, JsonCause.VALUE_TYPE),
    (21, {"Text": 7}, JsonCause.VALUE_TYPE),
    (22, {"X": 1}, JsonCause.STRUCTURE),
    (22, {"UaTypeId": "i=5", "UaEncoding": 3, "UaBody": ""}, JsonCause.STRUCTURE),
    (23, 7, JsonCause.VALUE_TYPE),
    (24, {"UaType": 26, "Value": 1}, JsonCause.UA_TYPE),
    (24, {"UaType": True, "Value": 1}, JsonCause.UA_TYPE),
    (24, {"UaType": 24, "Value": {"UaType": 1, "Value": True}}, JsonCause.UA_TYPE),
    (24, {"Value": 1}, JsonCause.UA_TYPE),
    (24, {"UaType": 6, "Value": [1, 2, 3], "Dimensions": [2, 2]}, JsonCause.DIMENSIONS),
    (24, {"UaType": 6, "Value": [[1, 2], [3]]}, JsonCause.DIMENSIONS),
    (24, {"UaType": 6, "Value": [], "Dimensions": [2**31 - 1, 2**31 - 1]}, JsonCause.DIMENSIONS),
    (24, {"UaType": 6, "Value": 1, "Dimensions": [1]}, JsonCause.DIMENSIONS),
]


@pytest.mark.parametrize(("kind", "text", "cause"), WRONG)
def test_what_is_no_value_of_its_type_is_refused_by_cause(kind: int, text: Any, cause: JsonCause) -> None:
    with pytest.raises(RemoteWireError) as caught:
        decode_element(Reading(NAMESPACES), kind, text)
    assert caught.value.cause == cause


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (1, 1),
        (2, 128),
        (6, True),
        (9, -1),
        (10, 1e39),
        (11, "x"),
        (12, 5),
        (13, 2**63),
        (14, "x"),
        (15, "x"),
        (17, 5),
        (17, NodeId(2**16, 1)),
        (18, NodeId(0, 1)),
        (19, 2**32),
        (20, "x"),
        (21, "x"),
        (22, b""),
        (23, 1),
        (24, 1),
        (26, 1),
    ],
)
def test_our_own_mistakes_are_local(kind: int, value: Any) -> None:
    with pytest.raises(LocalWireError):
        encode_element(VERBOSE, kind, value)


def in_each_other(kind: int, levels: int) -> Any:
    """So many values of a type that may hold one of its own."""
    value: Any = DiagnosticInfo(symbolic_id=1) if kind == 25 else DataValue(Variant(6, 1))
    for _ in range(levels - 1):
        value = DiagnosticInfo(inner=value) if kind == 25 else DataValue(Variant(23, value))
    return value


@pytest.mark.parametrize("kind", [23, 25])
def test_values_in_each_other_are_written_to_the_depth_of_the_binary_encoding(kind: int) -> None:
    deepest = in_each_other(kind, DEEPEST_NESTING)
    if kind == 25:
        assert decode_element(Reading(), kind, encode_element(VERBOSE, kind, deepest)) == deepest
    encode_typed(bytearray(), kind, deepest)
    for levels in (DEEPEST_NESTING + 1, 100_000):
        deeper = in_each_other(kind, levels)
        with pytest.raises(LocalWireError, match="nested deeper than 16 levels"):
            encode_element(VERBOSE, kind, deeper)
        with pytest.raises(LocalWireError, match="nested deeper than 16 levels"):
            encode_typed(bytearray(), kind, deeper)


def test_the_last_of_two_members_with_one_name_counts() -> None:
    assert parse(b'{"a": 1, "a": 2}', Reading()) == {"a": 2}


def test_a_byte_order_mark_is_passed_over_and_counted() -> None:
    reading = Reading()
    assert parse(b"\xef\xbb\xbf[1]", reading) == [1]
    assert reading.leniencies == {Leniency.BYTE_ORDER_MARK: 1}


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (b" " * (DEFAULT_LIMITS.bytes + 1), JsonCause.SIZE),
        (b"[" + b"0," * 300_000 + b"0]", JsonCause.ELEMENTS),
        (b"[" * 40 + b"]" * 40, JsonCause.DEPTH),
        (b"[" * 100_000, JsonCause.SYNTAX),
        (b'{"a": }', JsonCause.SYNTAX),
        (b'"\xff"', JsonCause.SYNTAX),
        (b"1e999", JsonCause.SYNTAX),
        (b"", JsonCause.SYNTAX),
        (b"NaN", JsonCause.SYNTAX),
    ],
)
def test_budgets_and_syntax(text: bytes, cause: JsonCause) -> None:
    with pytest.raises(RemoteWireError) as caught:
        parse(text, Reading())
    assert caught.value.cause == cause


def test_the_limits_are_the_callers() -> None:
    assert parse(b"[[1]]", Reading(), Limits(depth=2)) == [[1]]
    with pytest.raises(RemoteWireError):
        parse(b"[[[1]]]", Reading(), Limits(depth=2))


def test_what_json_cannot_hold_is_a_mistake_of_ours() -> None:
    with pytest.raises(LocalWireError):
        dump(object())
