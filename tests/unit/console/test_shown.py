"""Values as JSON: a browser reads back what it can hold, and is told of what it cannot."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.console.board import encoded
from ua_fleet.console.outline import outline
from ua_fleet.console.shown import harmless_value, shown_value

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters()) | st.binary(max_size=2000),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(st.characters()), inner, max_size=5),
    max_leaves=20,
)


@given(VALUES)
def test_whatever_there_is_can_be_sent(value: Any) -> None:
    json.loads(encoded(shown_value(value)).encode("utf-8"))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (2**53 - 1, 2**53 - 1),
        (2**53, {"int": "9007199254740992"}),
        (-(2**63), {"int": "-9223372036854775808"}),
        (True, True),
        (math.nan, {"float": "NaN"}),
        (-math.inf, {"float": "-Infinity"}),
        (b"ab", {"bytes": 2, "base64": "YWI="}),
        (b"x" * 2000, {"bytes": 2000}),
        (datetime(2030, 1, 31, 12, 0, 0, 123456, UTC), "2030-01-31T12:00:00.123Z"),
        ("x" * 20_000, {"text": 20_000, "first": "x" * 16_384}),
        ("\ud800", "?"),
        ({"a": [1, {"b": math.nan}]}, {"a": [1, {"b": {"float": "NaN"}}]}),
    ],
)
def test_values(value: Any, expected: Any) -> None:
    assert shown_value(value) == expected


def test_long_arrays_and_deep_structures_are_cut() -> None:
    shown = shown_value(list(range(100_000)))
    assert (shown["array"], len(shown["first"])) == (100_000, 1000)
    deep: Any = 1
    for _ in range(1000):
        deep = [deep]
    assert "deep" in encoded(shown_value(deep))


@given(VALUES)
def test_names_and_messages_are_harmless_all_the_way_down(value: Any) -> None:
    def texts(part: Any) -> list[str]:
        if isinstance(part, str):
            return [part]
        inner: list[Any] = [*part.keys(), *part.values()] if isinstance(part, dict) else []
        inner += part if isinstance(part, list) else []
        return [text for one in inner for text in texts(one)]

    assert all(text.isprintable() for text in texts(harmless_value(shown_value(value))))


@given(st.text(max_size=300))
def test_an_outline_of_anything_is_one(text: str) -> None:
    told = outline(text)
    json.loads(encoded(told).encode("utf-8"))
    assert told["problems"] or told["steps"]
