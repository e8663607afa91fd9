from __future__ import annotations

import sys
from typing import Any, ClassVar

import pytest
from asyncua import ua
from asyncua.server.address_space import AddressSpace
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.endpoint import filters
from ua_fleet.endpoint.event_fields import EventFields
from ua_fleet.endpoint.filters import check_event_filter
from ua_fleet.endpoint.indexrange import parse_range
from ua_fleet.endpoint.stack import AttributeIds, Refusal

NOWHERE = AddressSpace()
"""An address space of no nodes: these filters are not evaluated."""
FIELDS = EventFields(NOWHERE)
evaluator: Any = filters._Evaluator.__new__(filters._Evaluator)  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    ("text", "pattern", "matches"),
    [
        ("main", "main", True),
        ("main", "Main", False),
        ("main", "m%", True),
        ("main", "%in", True),
        ("main", "m__n", True),
        ("main", "m_n", False),
        ("", "%", True),
        ("", "_", False),
        ("abc", "a[bx]c", True),
        ("abc", "a[^bx]c", False),
        ("a5c", "a[0-9]c", True),
        ("axc", "a[0-9]c", False),
        ("a^c", "a[0^]c", True),
        ("a-c", "a[x-]c", True),
        ("a5c", "a[9-0]c", False),
        ("a5c", "a[^9-0]c", True),
        ("a]c", "a\\]c", True),
        ("aa", "a%a", True),
        ("a", "a%a", False),
        ("abab", "%ab", True),
        ("x" * 1_000 + "a", "%a", False),  # a text of more characters than are looked at
        ("50%", "50\\%", True),
        ("500", "50\\%", False),
        ("a\nb", "a%b", True),
        ("aXbXc", "a%b%c", True),
        ("a.c", "abc", False),
        ("abc", "a.c", False),
        (1, "1", False),
    ],
)
def test_like(text: Any, pattern: str, matches: bool) -> None:
    assert evaluator._like_operator(text, pattern) is matches


@given(st.text("ab", max_size=8), st.text("ab%_", max_size=8))
def test_like_is_what_its_definition_says(text: str, pattern: str) -> None:
    def defined(t: str, p: str) -> bool:
        if not p:
            return not t
        if p[0] == "%":
            return any(defined(t[cut:], p[1:]) for cut in range(len(t) + 1))
        return bool(t) and p[0] in ("_", t[0]) and defined(t[1:], p[1:])

    assert evaluator._like_operator(text, pattern) is defined(text, pattern)


def event_filter(*elements: ua.ContentFilterElement, fields: int = 1) -> ua.EventFilter:
    made = ua.EventFilter()
    made.SelectClauses = [ua.SimpleAttributeOperand() for _ in range(fields)]
    made.WhereClause = ua.ContentFilter(list(elements))
    return made


def element(operator: ua.FilterOperator, *operands: Any) -> ua.ContentFilterElement:
    return ua.ContentFilterElement(operator, list(operands))


def literal(value: Any) -> ua.LiteralOperand:
    return ua.LiteralOperand(ua.Variant(value))


def test_a_filter_costs_what_one_event_takes() -> None:
    def cost(wanted: ua.EventFilter) -> int:
        return check_event_filter(NOWHERE, wanted, 100, FIELDS).cost

    assert cost(event_filter(fields=7)) == 7
    equal = element(ua.FilterOperator.Equals, literal(1), literal(1))
    assert cost(event_filter(equal)) == 1 + 3
    either = element(ua.FilterOperator.Or, ua.ElementOperand(1), ua.ElementOperand(1))
    assert cost(event_filter(either, equal)) == 1 + 1 + 2 * 3
    many = element(ua.FilterOperator.InList, *[literal(1)] * 90)
    assert cost(event_filter(many)) == 1 + 91
    assert cost(event_filter(element(ua.FilterOperator.Like, literal("a"), literal("%" * 150)))) > 150


@pytest.mark.parametrize(
    "wanted",
    [
        event_filter(element(ua.FilterOperator.Like, literal("a"), ua.SimpleAttributeOperand())),
        event_filter(element(ua.FilterOperator.Like, literal("a"), literal("%" * 201))),
        event_filter(element(ua.FilterOperator.Like, literal("a"), literal(1))),
        event_filter(element(ua.FilterOperator.Equals, literal("a" * 100_000), literal("a" * 100_000))),
        event_filter(
            element(ua.FilterOperator.InList, *[ua.ElementOperand(1)] * 10),
            *[element(ua.FilterOperator.Like, literal("a" * 900), literal("%_" * 99 + "b"))],
        ),
    ],
    ids=["pattern of the event", "long pattern", "no pattern", "large literals", "many patterns"],
)
def test_a_filter_that_would_take_long_is_refused(wanted: ua.EventFilter) -> None:
    with pytest.raises(Refusal):
        check_event_filter(NOWHERE, wanted, 100, FIELDS)


def test_the_costliest_pattern_takes_no_more_steps_of_python_than_it_has_parts() -> None:
    text, steps = "a" * 1_000, 0

    def count(*_: Any) -> None:
        nonlocal steps
        steps += 1

    sys.setprofile(count)
    try:
        assert not evaluator._like_operator(text, "%_a" * 66 + "b")
    finally:
        sys.setprofile(None)
    assert steps < 5_000


@pytest.mark.parametrize("text", ["\u0660", "1:\u0662"])
def test_ranges_have_the_digits_of_ascii_alone(text: str) -> None:
    with pytest.raises(Refusal):
        parse_range(text)


@given(st.text(max_size=30))
def test_ranges_are_slices_or_refused(text: str) -> None:
    try:
        parsed = parse_range(text)
    except Refusal:
        return
    if not text:
        assert parsed is None
    else:
        assert parsed is not None
        assert all(0 <= part.start < part.stop for part in parsed)


class Happened:
    """An event with two fields; nobody has said what the other one is."""

    data_types: ClassVar[dict[str, Any]] = {
        "Severity": ua.VariantType.UInt16,
        "ActiveState": ua.VariantType.LocalizedText,
        "ActiveState/Id": ua.VariantType.Boolean,
        "Comment": ua.VariantType.String,
    }
    Severity = 500
    ActiveState = ua.LocalizedText("Active")
    Comment = None


setattr(Happened, "ActiveState/Id", True)


def operand(*path: str) -> Any:
    made: Any = ua.SimpleAttributeOperand()
    made.BrowsePath = [ua.QualifiedName(name, ua.UInt16(0)) for name in path]
    made.AttributeId = AttributeIds.Value
    return made


EQUALS, GREATER, OPERATORS = ua.FilterOperator.Equals, ua.FilterOperator.GreaterThan, ua.FilterOperator
TRUE, FALSE = element(EQUALS, literal(1), literal(1)), element(EQUALS, literal(1), literal(2))
NULL = element(OPERATORS.Not, operand("Nowhere"))


@pytest.mark.parametrize(
    ("elements", "passes"),
    [
        ([element(EQUALS, operand("ActiveState", "Id"), literal(True))], True),
        ([element(EQUALS, operand("ActiveState", "Id"), literal(False))], False),
        ([element(GREATER, operand("Severity"), literal(400))], True),
        ([element(OPERATORS.IsNull, operand("Nowhere"))], True),
        ([element(OPERATORS.IsNull, operand("Comment"))], True),
        ([element(OPERATORS.IsNull, operand("Severity"))], False),
        ([element(GREATER, operand("Nowhere"), literal(400))], False),
        ([element(EQUALS, operand("data_types"), literal(1))], False),
        ([element(OPERATORS.Or, ua.ElementOperand(1), ua.ElementOperand(2)), NULL, TRUE], True),
        ([element(OPERATORS.Or, ua.ElementOperand(1), ua.ElementOperand(2)), TRUE, NULL], True),
        ([element(OPERATORS.Or, ua.ElementOperand(1), ua.ElementOperand(2)), NULL, FALSE], False),
        ([element(OPERATORS.And, ua.ElementOperand(1), ua.ElementOperand(2)), NULL, TRUE], False),
        ([element(OPERATORS.And, ua.ElementOperand(1), ua.ElementOperand(2)), TRUE, NULL], False),
        ([element(OPERATORS.And, ua.ElementOperand(1), ua.ElementOperand(2)), TRUE, TRUE], True),
        ([element(OPERATORS.Not, ua.ElementOperand(1)), NULL], False),
        ([element(OPERATORS.Not, ua.ElementOperand(1)), FALSE], True),
        ([element(OPERATORS.Not, ua.ElementOperand(1)), element(GREATER, operand("Nowhere"), literal(1))], True),
        *(
            (
                [
                    element(OPERATORS.IsNull, ua.ElementOperand(1)),
                    element(operator, ua.ElementOperand(2), ua.ElementOperand(3)),
                    *both,
                ],
                is_null,
            )
            for operator, both, is_null in (
                (OPERATORS.And, (NULL, FALSE), False),
                (OPERATORS.And, (FALSE, NULL), False),
                (OPERATORS.And, (NULL, TRUE), True),
                (OPERATORS.And, (TRUE, NULL), True),
                (OPERATORS.Or, (NULL, TRUE), False),
                (OPERATORS.Or, (FALSE, NULL), True),
                (OPERATORS.Or, (NULL, FALSE), True),
            )
        ),
        ([element(OPERATORS.InList, operand("Nowhere"), literal(0), literal(1))], False),
        ([element(OPERATORS.Between, operand("Severity"), literal(1), literal(500))], True),
        ([element(OPERATORS.Between, operand("Severity"), operand("Nowhere"), literal(500))], False),
        ([element(OPERATORS.Like, operand("Nowhere"), literal("%"))], False),
    ],
)
def test_a_field_that_an_event_has_not_is_null(elements: list[ua.ContentFilterElement], passes: bool) -> None:
    """OPC 10000-4 7.7.3: a comparison with null is false; And, Or and Not have three values."""
    assert check_event_filter(NOWHERE, event_filter(*elements), 100, FIELDS).passes(Happened()) is passes
