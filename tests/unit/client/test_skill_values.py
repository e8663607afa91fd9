"""Arguments of skills: from Python to the declared types."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any

import pytest
from asyncua import ua

from ua_fleet.client import FleetClient
from ua_fleet.client.skills import fitting

KIND = ua.VariantType


@pytest.mark.parametrize(
    ("value", "kind", "expected"),
    [
        (True, KIND.Boolean, True),
        (1, KIND.Boolean, None),
        ("a", KIND.String, "a"),
        (1, KIND.String, None),
        (2, KIND.Double, 2.0),
        (math.nan, KIND.Double, None),
        (True, KIND.Double, None),
        ("2", KIND.Double, None),
        (3.0, KIND.Int32, 3),
        (3.5, KIND.Int32, None),
        (-128, KIND.SByte, -128),
        (-129, KIND.SByte, None),
        (255, KIND.Byte, 255),
        (256, KIND.Byte, None),
        (-1, KIND.UInt16, None),
        (32767, KIND.Int16, 32767),
        (2**32 - 1, KIND.UInt32, 2**32 - 1),
        (2**63, KIND.Int64, None),
        (2**64 - 1, KIND.UInt64, 2**64 - 1),
    ],
)
def test_values_fit_exactly_or_not_at_all(value: Any, kind: ua.VariantType, expected: Any) -> None:
    fitted = fitting(value, kind)
    assert fitted == expected
    assert type(fitted) is type(expected)


@pytest.mark.parametrize("call", [FleetClient.start_skill, FleetClient.call_skill])
def test_arguments_may_have_the_names_of_what_is_called(call: Callable[..., Any]) -> None:
    given = {"self": 1, "robot": "cart", "skill": 2.5}
    bound = inspect.signature(call).bind(None, "arm", "turn", **given)
    assert bound.arguments["arguments"] == given
