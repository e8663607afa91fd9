"""Messages of fields, and values as fields."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_bridges.tcp.messages import Message, MessageReader, MessageRefused, Type, field_of, number_of, value_of

from ua_fleet.config.base import ScalarType


def read(*fields: str, most: int = 4) -> list[Message]:
    reader = MessageReader(most)
    messages = [message for field in fields if (message := reader.feed(field)) is not None]
    assert not reader.is_within
    return messages


def test_a_message_is_its_fields() -> None:
    message = Message(Type.STATUS, "done", 5, ("a", ""))
    assert message.fields() == ("status", "done", "5", "2", "a", "")
    assert read(*message.fields(), "information", "x", "0", "0") == [message, Message(Type.INFORMATION, "x", 0)]


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        (("",), "of type ''"),
        (("command",), "of type 'command'"),
        (("status", ""), "without subtype"),
        (("status", "done", "-1"), "no whole number"),
        (("status", "done", "2147483648"), "no whole number"),
        (("status", "done", "\u0661"), "no whole number"),
        (("status", "done", "1", "x"), "no whole number"),
        (("status", "done", "1", "5"), "most_fields is 4"),
    ],
)
def test_what_is_no_message_is_told(fields: tuple[str, ...], reason: str) -> None:
    with pytest.raises(MessageRefused, match=reason):
        read(*fields)


@given(st.binary(min_size=16, max_size=16))
def test_a_number_fits_into_a_robots_integer(execution_id: bytes) -> None:
    assert 1 <= number_of(execution_id) <= 2**31 - 1
    assert number_of(execution_id) == number_of(execution_id)


@pytest.mark.parametrize(
    ("value", "field"),
    [
        (True, "1"),
        (False, "0"),
        (-7, "-7"),
        (0.1, "0.1"),
        (1 / 3, "0.333333333333333"),
        (1_763_740_000.125, "1763740000.125"),
        (1e20, "1e+20"),
        (None, ""),
        ("a", "a"),
    ],
)
def test_values_as_fields(value: Any, field: str) -> None:
    assert field_of(value) == field


@pytest.mark.parametrize(
    ("field", "wanted", "value"),
    [
        ("1", ScalarType.BOOLEAN, True),
        ("TRUE", ScalarType.BOOLEAN, True),
        ("false", ScalarType.BOOLEAN, False),
        ("-32768", ScalarType.INT16, -32768),
        ("7.0", ScalarType.INT16, 7),
        ("18446744073709551615", ScalarType.UINT64, 2**64 - 1),
        ("1.5", ScalarType.DOUBLE, 1.5),
        ("", ScalarType.STRING, ""),
    ],
)
def test_fields_as_values(field: str, wanted: ScalarType, value: Any) -> None:
    assert value_of(field, wanted) == value


@pytest.mark.parametrize(
    ("field", "wanted"),
    [
        ("2", ScalarType.BOOLEAN),
        ("", ScalarType.INT16),
        ("32768", ScalarType.INT16),
        ("7.5", ScalarType.INT16),
        ("-1", ScalarType.BYTE),
        ("nan", ScalarType.DOUBLE),
        ("inf", ScalarType.DOUBLE),
        ("1_0", ScalarType.DOUBLE),
        ("1_0", ScalarType.INT32),
        ("9" * 60, ScalarType.INT32),
        ("1e400", ScalarType.INT32),
    ],
)
def test_fields_that_are_no_such_value(field: str, wanted: ScalarType) -> None:
    with pytest.raises(ValueError, match=r".+"):
        value_of(field, wanted)


def test_a_value_that_is_no_number_says_so_to_the_robot() -> None:
    assert field_of(math.nan) == "nan"
