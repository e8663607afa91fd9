from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.server.endpoint import filters
from ua_fleet.server.endpoint.indexrange import parse_range
from ua_fleet.server.endpoint.stack import Refusal

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


@pytest.mark.timeout(30)
def test_no_pattern_takes_for_ever() -> None:
    assert not evaluator._like_operator("a" * 10_000, "%a" * 99 + "b")


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
