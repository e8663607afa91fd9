"""Rows as bytes, and back; and as other readers of OPC UA see them."""

from __future__ import annotations

import random
from typing import Any

import pytest

from ua_fleet.history.blocks import decode_block, decode_value, encode_block, encode_rows, encode_value
from ua_fleet.history.rows import BAD_BOUND_NOT_FOUND, BAD_DATA_LOST, Row
from ua_fleet.values import BuiltinType, DataValue, StatusCode, Variant
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.variant import decode_data_value

VALUES: dict[int, list[Any]] = {
    BuiltinType.BOOLEAN: [True, False],
    BuiltinType.INT16: [-5, 7],
    BuiltinType.UINT64: [0, 2**64 - 1],
    BuiltinType.FLOAT: [0.5, -2.0],
    BuiltinType.DOUBLE: [1e300, -0.25],
    BuiltinType.STRING: ["", "ü", None],
    BuiltinType.DATETIME: [0, 2**62],
    BuiltinType.BYTE_STRING: [b"", b"\0\xff"],
    BuiltinType.DOUBLE | 0x80: [(), (1.0, 2.0), None],
    BuiltinType.STRING | 0x80: [("a", None)],
}
ROWS = [
    Row(1000 + 10 * number, status, int(kind), value)
    for number, (kind, value, status) in enumerate(
        (kind, value, status) for kind, values in VALUES.items() for value in values for status in (0, 0x4090_0000)
    )
]
MARK = Row(9_000_000, BAD_DATA_LOST, 0, None)


def test_a_row_of_each_type_comes_back() -> None:
    for row in [*ROWS, MARK]:
        assert decode_value(row.time, row.status, encode_value(row)) == row


@pytest.mark.parametrize("kind", VALUES)
def test_a_block_of_one_type_comes_back(kind: int) -> None:
    rows = [row for row in ROWS if row.type == kind]
    assert decode_block(encode_block(rows)) == rows


def test_a_block_of_anything_comes_back() -> None:
    assert decode_block(encode_block([*ROWS, MARK])) == [*ROWS, MARK]
    assert decode_block(encode_block([MARK])) == [MARK]


def test_what_cannot_be_encoded_leaves_its_status() -> None:
    bad = Row(1, 0, int(BuiltinType.INT16), "text")
    assert encode_value(bad) == b""
    data, count = encode_rows([bad], 1000, 1000)
    assert count == 1
    assert decode_data_value(Cursor(data, 4)) == DataValue(None, 0x8006_0000, 1)


def test_a_compact_value_takes_at_most_24_bytes() -> None:
    random_ = random.Random(7)
    time, rows = 134_000_000_000_000_000, list[Row]()
    for _ in range(1000):
        time += 1_000_000 + random_.randrange(-40_000, 40_000)
        rows.append(Row(time, 0, int(BuiltinType.DOUBLE), random_.gauss(20, 3)))
    assert len(encode_block(rows)) / len(rows) <= 16


def test_clients_see_data_values() -> None:
    rows = [*ROWS, MARK]
    data, count = encode_rows(rows, 100_000, 100_000)
    assert count == len(rows)
    cursor = Cursor(data)
    assert cursor.uint32() == len(rows)
    for row in rows:
        value = decode_data_value(cursor)
        expected = DataValue(Variant(row.type, row.value) if row.type else None, row.status, row.time)
        assert value == expected
    assert cursor.remaining == 0


@pytest.mark.parametrize("value", [3.5e38, -1e300])
@pytest.mark.parametrize("status", [0, 0x40A4_0402])
def test_what_is_too_large_for_its_type_is_told_by_its_time(value: float, status: int) -> None:
    """A line through two Floats goes on as far as a client asks."""
    data, count = encode_rows([Row(7, status, int(BuiltinType.FLOAT), value)], 100, 100)
    assert count == 1
    assert decode_data_value(Cursor(data, 4)) == DataValue(None, StatusCode.BAD_ENCODING_ERROR, 7)


def test_as_many_values_as_fit() -> None:
    rows = [Row(time, 0, int(BuiltinType.DOUBLE), 1.0) for time in range(10)]
    data, count = encode_rows(rows, 4 + 3 * 18 + 17, 1000)
    assert (count, len(data)) == (3, 4 + 3 * 18)
    assert encode_rows(rows, 10, 1000) == (bytes(4), 0)
    assert decode_data_value(Cursor(encode_rows([None], 100, 100)[0], 4)) == DataValue(None, BAD_BOUND_NOT_FOUND)


def test_a_value_that_no_answer_has_room_for_does_not_hold_up_those_behind_it() -> None:
    rows = [Row(1, 0, 12, "small"), Row(2, 0, 12, "large" * 100), Row(3, 0, 12, "small")]
    assert encode_rows(rows, 400, 1000)[1] == 1  # it comes first in the next answer
    assert encode_rows(rows[1:], 1000, 1000)[1] == 2
    data, count = encode_rows(rows, 400, 400)
    assert count == 3
    cursor = Cursor(data, 4)
    found = [decode_data_value(cursor) for _ in rows]
    assert [value.status for value in found] == [0, StatusCode.BAD_ENCODING_LIMITS_EXCEEDED, 0]
    assert found[1].variant is None
    assert [value.source_timestamp for value in found] == [1, 2, 3]
