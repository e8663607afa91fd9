"""Faults as a table says them."""

from __future__ import annotations

import pytest

from ua_fleet.cli.decision import taken_away
from ua_fleet.client import FaultInfo


@pytest.mark.parametrize(
    ("source", "capacities", "said"),
    [("silent", (), "nothing"), ("robot", (), "all"), ("announced", ("mobile", "grab"), "mobile grab")],
)
def test_what_a_fault_takes_away(source: str, capacities: tuple[str, ...], said: str) -> None:
    assert taken_away(FaultInfo(f"rover.{source}", "rover", source, "why", True, False, capacities)) == said
