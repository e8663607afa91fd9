"""Runs over the whole chain, each decided by its seed; the robot's own record is the judge (`judge.py`)."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import chain, groupby
from typing import Any, Final

import pytest

from tests import system
from tests.teleoperation.plan import plan_of, round_of
from tests.teleoperation.run import Outcome, run_round
from tests.teleoperation.stack import Stack, running_stack

pytestmark = pytest.mark.needs("ros1", "ros2")
FEW: Final = 24
"""Seeds of the usual test run, which has little time."""


def _seeds() -> list[int]:
    """Those that are asked for: `0-199`, or `17,44`."""
    found: list[int] = []
    for part in os.environ.get("UA_FLEET_TELEOPERATION_SEEDS", f"0-{FEW - 1}").split(","):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


ROUNDS: Final = {number: list(seeds) for number, seeds in groupby(sorted(set(_seeds())), round_of)}


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stack]:
    pages = {plan.lane for plan in map(plan_of, chain(*ROUNDS.values())) if plan.is_page}
    if system.missing("chromium") is not None:
        pages.clear()
    with running_stack(tmp_path_factory.mktemp("chain"), pages) as running:
        yield running


def _round(seeds: list[int]) -> Any:
    marks = [pytest.mark.needs("chromium")] if any(plan_of(seed).is_page for seed in seeds) else []
    return pytest.param(seeds, marks=marks, id=f"{seeds[0]}-{seeds[-1]}")


@pytest.mark.parametrize("seeds", [_round(seeds) for seeds in ROUNDS.values()])
async def test_the_robot_is_stopped_in_time_and_has_one_commander(stack: Stack, seeds: list[int]) -> None:
    try:
        outcomes = await run_round(stack.lanes, [plan_of(seed) for seed in seeds])
    finally:
        await stack.close()
    for outcome in outcomes:
        print(_line(outcome))
    problems = [f"{outcome.plan}\n  {problem}" for outcome in outcomes for problem in outcome.problems]
    failed = ",".join(str(outcome.plan.seed) for outcome in outcomes if outcome.problems)
    said = f"run it alone: UA_FLEET_TELEOPERATION_SEEDS={failed} .venv/bin/python -m pytest {__file__}"
    assert not problems, "\n".join([*problems, said])


def _line(outcome: Outcome) -> str:
    stops = ", ".join(f"{stop.unexplained_s * 1000:+.0f} ms, {stop.took_s * 1000:.0f} ms" for stop in outcome.stops)
    return "\n  ".join([f"{outcome.plan}: {stops}", *outcome.problems])
