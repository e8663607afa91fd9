"""Runs of the testbed are scenarios that fit its fleet, and what goes wrong in them is seen."""

from __future__ import annotations

import pytest

from tests.testbed.ledger import Begun
from tests.testbed.runs import CASES, RunCase, RunRow, problems_of, run_lines
from ua_fleet.scenario.read import read_scenario


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.service)
def test_each_case_is_a_scenario(case: RunCase) -> None:
    assert read_scenario(case.text().encode(), case.service).problems == ()


def row(state: str = "done", *, was_under_way: bool = True, begun: int = 2) -> RunRow:
    told = [Begun("drone", float(at)) for at in range(begun)]
    return RunRow("drone-bridge", state, "", was_under_way, 1.25, {"drone": 2}, [*told, Begun("ur3", 1.0)])


def test_what_is_right() -> None:
    assert problems_of(row()) == []
    assert run_lines([row()])[-1] == "| `drone-bridge` | done | 1.2 s | 2 | 2 |"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (row("failed"), "a run is failed after the kill of drone-bridge"),
        (row("running"), "a run is running after the kill of drone-bridge"),
        (row(was_under_way=False), "a run was done before drone-bridge was killed"),
        (row(begun=3), "drone has 2 tasks, began 3"),
        (row(begun=1), "drone has 2 tasks, began 1"),
    ],
)
def test_what_is_wrong(wrong: RunRow, said: str) -> None:
    (problem,) = problems_of(wrong)
    assert said in problem
