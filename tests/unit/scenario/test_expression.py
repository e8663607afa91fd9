"""Conditions: what they come to, and what they must not reach."""

from __future__ import annotations

import math
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.scenario.expression import ExpressionInvalid, Value, ValueUnknown, parse_expression, split_index

VALUES: dict[str, Value] = {
    "temperature": 21.5,
    "ur3.temperature": 19,
    "fetch.weight": 3,
    "gate.open": False,
    "mode": "night",
    "limit": 5,
    "huge": 10**400,
    "agv-1.battery": 30,
    "agv-1.joints[1]": 2.5,
    "agv": 100,
    "in": True,
}


def lookup(name: str) -> Value:
    try:
        return VALUES[name]
    except KeyError:
        raise ValueUnknown(f"{name} is not known") from None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("temperature > 20", True),
        ("ur3.temperature > 20", False),
        ("temperature >= 21.5 and not gate.open", True),
        ("gate.open or fetch.weight <= limit", True),
        ("18 < ur3.temperature < 20", True),
        ("`agv-1.battery` < 40 and `in`", True),
        ("`agv-1`.battery == 30", True),
        ("`agv-1.joints`[1] + `temperature` == 24", True),
        ("agv-1 == 99", True),
        ("mode == '`in`' or mode == \"a `quote`'s\"", False),
        ("18 < ur3.temperature < 19", False),
        ("mode == 'night'", True),
        ('mode != "night"', False),
        ("gate.open == false", True),
        ("not (temperature > 20 and true)", False),
        ("-fetch.weight < -2", True),
        ("fetch.weight * 2 + 1 == 7", True),
        ("limit / 2 == 2.5", True),
        ("  temperature > 20  ", True),
    ],
)
def test_what_it_comes_to(text: str, expected: bool) -> None:
    assert parse_expression(text).holds(lookup) is expected


def test_names_are_all_that_it_mentions() -> None:
    expression = parse_expression("temperature > 20 and (ur3.temperature < limit or not true)")
    assert expression.names == {"temperature", "ur3.temperature", "limit"}


def test_an_element_of_an_array_is_a_name() -> None:
    expression = parse_expression("ur3.joints[ 1 ] > 0.5")
    assert expression.names == {"ur3.joints[1]"}
    assert expression.holds({"ur3.joints[1]": 0.6}.__getitem__)
    assert [split_index(name) for name in ("ur3.joints[12]", "battery")] == [("ur3.joints", 12), ("battery", None)]


def test_and_and_or_stop_where_the_answer_is_known() -> None:
    assert parse_expression("gate.open and nowhere.there").holds(lookup) is False
    assert parse_expression("temperature > 1 or nowhere.there").holds(lookup) is True


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nowhere.there > 1", "nowhere.there is not known"),
        ("mode > 1", "'night' is no number"),
        ("mode == 1", "cannot be compared"),
        ("gate.open == 0", "cannot be compared"),
        ("temperature", "neither true nor false"),
        ("not temperature", "neither true nor false"),
        ("temperature and true", "neither true nor false"),
        ("1 / 0 > 1", "division by zero"),
        (f"{10**300} * {10**300} > 1", "too large"),
        ("huge / 2.5 > 1", "too large"),
        ("huge > 1", "too large"),
        ("1e308 * 10.0 - 1e308 * 10.0 > true", "is no number"),
    ],
)
def test_what_cannot_be_decided_says_why(text: str, said: str) -> None:
    with pytest.raises(ValueUnknown, match=said):
        parse_expression(text).holds(lookup)


def test_nothing_is_greater_than_what_is_no_number() -> None:
    assert parse_expression("temperature > x").holds({"temperature": 1.0, "x": math.nan}.__getitem__) is False


@pytest.mark.parametrize(
    "text",
    [
        "",
        "temperature >",
        "temperature = 20",
        "__import__('os').system('true')",
        "open('/etc/passwd')",
        "().__class__",
        "'a'.upper()",
        "[1, 2]",
        "{1: 2}",
        "x[-1]",
        "x[i]",
        "x[0:1]",
        "x[true]",
        "x['a']",
        "f()[0]",
        "lambda: 1",
        "a if b else c",
        "f'{x}'",
        "x := 1",
        "1 if 2 else 3",
        "a in b",
        "a is b",
        "2 ** 9",
        "1 // 2",
        "~1",
        "b'x'",
        f"go > {10**400}",
        "1j",
        "None",
        "...",
        "a; b",
        "a > 1\nb > 1",
        "x" * 1001,
        "(" * 500 + "1" + ")" * 500,
        "not " * 100 + "a",
        "\0",
        "[" * 400,
    ],
)
def test_everything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ExpressionInvalid) as caught:
        parse_expression(text)
    assert "\n" not in str(caught.value)


@given(st.text(max_size=60))
def test_whatever_the_text_only_the_two_errors_come_out(text: str) -> None:
    with suppress(ExpressionInvalid, ValueUnknown):
        parse_expression(text).holds(lookup)


def _joined(parts: tuple[str, str, str]) -> str:
    return f"({' '.join(parts)})"


OPERATORS = st.sampled_from(["and", "or", "<", "==", "+", "*", "/", "-", ">=", "!="])
OPERANDS = st.sampled_from(["temperature", "1", "2.5", "'a'", "true", "limit"])


@given(st.recursive(OPERANDS, lambda inner: st.tuples(inner, OPERATORS, inner).map(_joined), max_leaves=12))
def test_whatever_is_well_formed_can_be_read(text: str) -> None:
    expression = parse_expression(text)
    with suppress(ValueUnknown):
        expression.value(lookup)


def test_a_name_in_backquotes_is_one_of_the_names() -> None:
    assert parse_expression("`agv-1.battery` - `in.x` > limit").names == {"agv-1.battery", "in.x", "limit"}


@pytest.mark.parametrize("text", ["agv-1.battery < 20", "in", "from == 'dock'", "`agv 1` < 2", "`agv-1.battery < 20"])
def test_how_to_write_a_name_is_said(text: str) -> None:
    with pytest.raises(ExpressionInvalid) as refused:
        parse_expression(text)
    if "`" not in text:
        assert "backquotes" in str(refused.value)


def test_the_place_is_that_in_the_text() -> None:
    with pytest.raises(ExpressionInvalid, match="at character 22;"):
        parse_expression("`agv-1.battery` < 20 )")
