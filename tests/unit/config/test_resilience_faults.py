"""Faults by conditions in `fleet.yaml`."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from ua_fleet.config.resilience_schema import ResilienceConfig


def test_conditions_are_read() -> None:
    config = ResilienceConfig.model_validate(
        {"faults": {"low": {"robots": ["ur3"], "when": "battery < 20", "until": "battery > 30", "reason": "empty"}}}
    )
    (rule,) = config.rules()
    assert (rule.name, rule.robots, rule.when.text, rule.reason) == ("low", ("ur3",), "battery < 20", "empty")
    assert rule.until is not None


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ({"low": {"robots": ["ur3"], "when": "battery <"}}, "is no condition"),
        ({"low": {"robots": ["ur3"], "when": "a < 1", "until": "f(1)"}}, "no call here"),
        ({"low": {"robots": [], "when": "a < 1"}}, "robots"),
    ],
)
def test_mistakes_in_conditions(faults: object, said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        ResilienceConfig.model_validate({"faults": faults})
