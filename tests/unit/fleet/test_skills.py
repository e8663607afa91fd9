"""What is a legal value of an argument or a result."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ua_fleet.fleet.skills import ArgumentModel, argument_problem
from ua_fleet.values import BuiltinType

HUGE = 10**400


@pytest.mark.parametrize("kind", [BuiltinType.DOUBLE, BuiltinType.FLOAT, BuiltinType.INT64])
@pytest.mark.parametrize(
    "value",
    [
        math.nan,
        math.inf,
        -math.inf,
        pytest.param(HUGE, id="huge"),
        pytest.param(-HUGE, id="-huge"),
        True,
        "1",
        None,
        [1],
    ],
)
def test_what_robots_may_say_for_a_number_is_no_number(kind: BuiltinType, value: Any) -> None:
    problem = argument_problem(ArgumentModel("angle", kind), value)
    assert problem is not None
    assert problem.endswith("; it has to be a number")


@pytest.mark.parametrize("value", [0, -1, 2.5, 1.7976931348623157e308])
def test_numbers_are_numbers(value: float) -> None:
    assert argument_problem(ArgumentModel("angle", BuiltinType.DOUBLE), value) is None
