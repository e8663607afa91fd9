"""What `ua-fleet skill call` makes of its arguments; tests/integration/skills has the rest."""

from __future__ import annotations

from typing import Any

import pytest

from ua_fleet.cli.endings import UsageError
from ua_fleet.cli.skill import argument


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("angle=20", ("angle", 20)),
        ("angle=-2.5", ("angle", -2.5)),
        ("on=true", ("on", True)),
        ("work=weld", ("work", "weld")),
        ('work="20"', ("work", "20")),
        ("work=a=b", ("work", "a=b")),
        ("work=[1]", ("work", "[1]")),
        ("work=", ("work", "")),
    ],
)
def test_arguments_of_the_command_line(text: str, expected: tuple[str, Any]) -> None:
    assert argument(text) == expected


@pytest.mark.parametrize("text", ["angle", "=1", ""])
def test_what_is_no_argument(text: str) -> None:
    with pytest.raises(UsageError, match="write name=value"):
        argument(text)
