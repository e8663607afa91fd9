"""How each type looks, and what is not Good."""

from __future__ import annotations

import json
import math
import struct
import uuid
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.errors import LocalWireError
from ua_fleet.uns.payloads import Payload, encode_payload
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, ExtensionObject, Matrix, NodeId, StatusCode

T = BuiltinType
NOON = 133_500_000_000_000_001
GUID = uuid.UUID(int=7)
BAD, UNCERTAIN = StatusCode.BAD_NO_COMMUNICATION, StatusCode.UNCERTAIN_NO_COMMUNICATION_LAST_USABLE_VALUE

SHOWN: list[tuple[int, Any, str]] = [
    (T.BOOLEAN, True, "true"),
    (T.BYTE, 255, "255"),
    (T.INT64, -(2**63), "-9223372036854775808"),
    (T.UINT64, 2**64 - 1, "18446744073709551615"),
    (T.DOUBLE, 21.5, "21.5"),
    (T.DOUBLE, math.nan, "null"),
    (T.DOUBLE, -math.inf, "null"),
    (T.FLOAT, struct.unpack("<f", struct.pack("<f", 0.1))[0], "0.1"),
    (T.STRING, 'a "b" ü', '"a \\"b\\" ü"'),
    (T.STRING, None, "null"),
    (T.DATETIME, NOON, '"2024-01-17T21:20:00.0000001Z"'),
    (T.BYTE_STRING, b"\0\xff", '"AP8="'),
    (T.BYTE_STRING, memoryview(b"\0\xff"), '"AP8="'),
    (T.GUID, GUID, f'"{GUID}"'),
    (T.DOUBLE | ARRAY, (0.5, math.nan), "[0.5,null]"),
    (T.DOUBLE | ARRAY, memoryview(struct.pack("<2d", 0.5, 2.0)).cast("d"), "[0.5,2.0]"),
    (T.DOUBLE | ARRAY, (), "[]"),
    (T.DOUBLE | ARRAY, None, "null"),
    (T.INT32 | ARRAY | DIMENSIONS, Matrix((1, 2, 3, 4, 5, 6), (2, 3)), "[[1,2,3],[4,5,6]]"),
    (T.BYTE_STRING | ARRAY, (b"\0\xff", None), '["AP8=",null]'),
    (0, None, "null"),
]


@pytest.mark.parametrize(("type_code", "value", "text"), SHOWN)
def test_each_type_as_a_bare_value_and_in_an_object(type_code: int, value: Any, text: str) -> None:
    assert encode_payload(Payload.VALUE, type_code, value, 0, NOON).decode() == text
    shown = encode_payload(Payload.OBJECT, type_code, value, 0, NOON).decode()
    assert shown == f'{{"value":{text},"time":"2024-01-17T21:20:00.0000001Z","quality":"Good"}}'


@pytest.mark.parametrize("status", [BAD, UNCERTAIN, StatusCode.BAD_WAITING_FOR_INITIAL_DATA])
def test_a_bare_value_that_is_not_good_is_null(status: int) -> None:
    assert encode_payload(Payload.VALUE, T.DOUBLE, 21.5, status, NOON) == b"null"


def test_beside_a_quality_an_uncertain_value_stays_and_a_bad_one_does_not() -> None:
    bad = json.loads(encode_payload(Payload.OBJECT, T.DOUBLE, 21.5, BAD, NOON))
    assert bad == {"value": None, "time": "2024-01-17T21:20:00.0000001Z", "quality": "BadNoCommunication"}
    doubtful = json.loads(encode_payload(Payload.OBJECT, T.DOUBLE, 21.5, UNCERTAIN, None))
    assert doubtful == {"value": 21.5, "time": None, "quality": "UncertainNoCommunicationLastUsableValue"}


@pytest.mark.parametrize(
    ("status", "word"), [(0x8123_0000, "Bad"), (0x4123_0000, "Uncertain"), (0x0123_0000, "Good"), (0xC000_0000, "Bad")]
)
def test_a_quality_without_a_name_begins_with_its_severity(status: int, word: str) -> None:
    quality = json.loads(encode_payload(Payload.OBJECT, T.DOUBLE, 1.0, status, None))["quality"]
    assert quality == f"{word}0x{status:08X}"


@pytest.mark.parametrize(
    ("type_code", "value"),
    [
        (T.EXTENSION_OBJECT, ExtensionObject(NodeId(2, 1), b"")),
        (T.STRING, "\ud800"),
        (T.DOUBLE, "a text"),
        (T.FLOAT, 1e300),
        (T.INT32 | ARRAY, 7),
        (T.DATETIME, 2**70),
    ],
)
def test_what_json_cannot_hold_is_one_error(type_code: int, value: Any) -> None:
    with pytest.raises(LocalWireError):
        encode_payload(Payload.OBJECT, type_code, value, 0, None)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_float_reads_as_the_same_32_bits(value: float) -> None:
    read = json.loads(encode_payload(Payload.VALUE, T.FLOAT, value, 0, None))
    assert struct.pack("<f", read) == struct.pack("<f", value)
