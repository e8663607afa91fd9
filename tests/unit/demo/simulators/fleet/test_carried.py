"""A run that bridges carry: it comes to its end whatever fails, and costs what its fleet is large."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import log

import pytest
from ua_demo.equations import EQUATION_12_KINDS, equation_12_sum
from ua_demo.simulators.fleet import Result, Settings, report, simulate

from ua_fleet.traffic import MessageKind

SMALL = Settings(robots=6, tasks=12, carried=True)


@pytest.fixture(scope="module")
def small() -> Result:
    return simulate(SMALL)


def of_equation_12(counts: Mapping[MessageKind, int]) -> dict[MessageKind, int]:
    return {kind: counts[kind] for kind in EQUATION_12_KINDS}


def test_who_gets_a_datagram_changes_no_message_that_counts(small: Result) -> None:
    to_all = simulate(replace(SMALL, all_hear_all=True))
    assert of_equation_12(small.traffic.messages) == of_equation_12(to_all.traffic.messages)
    assert of_equation_12(small.traffic.bytes) == of_equation_12(to_all.traffic.bytes)
    assert small.is_right
    assert to_all.is_right


def test_the_same_seed_gives_the_same_report(small: Result) -> None:
    one, same = report.as_json(small), report.as_json(simulate(SMALL))
    assert {**one, "wall_s": 0} == {**same, "wall_s": 0}
    assert one["mode"] == "carried"


@pytest.mark.parametrize("faults", range(1, 6))
def test_whatever_fails_each_task_is_done_once_without_the_server(faults: int) -> None:
    result = simulate(replace(SMALL, faults=faults))
    assert result.is_right, result.reason
    assert len({failure.robot for failure in result.failures}) == len(result.failures) == faults
    assert all(failure.task and failure.replacement not in ("", failure.robot) for failure in result.failures)
    assert result.traffic.messages[MessageKind.FAULT] == faults


@pytest.mark.parametrize(("robots", "tasks"), [(1, 9), (4, 2), (3, 3)])
def test_small_fleets(robots: int, tasks: int) -> None:
    result = simulate(Settings(robots, tasks, carried=True))
    assert result.is_right, result.reason


def test_bytes_and_computing_grow_with_the_fleet_and_not_with_its_square() -> None:
    few, many = (simulate(Settings(robots, robots, keep_alive_s=600, carried=True)) for robots in (10, 500))
    assert few.is_right
    assert many.is_right, many.reason
    sums = [equation_12_sum(result.traffic.bytes) for result in (few, many)]
    assert log(sums[1] / sums[0]) / log(50) <= 1.1
    # 1.02 is measured on a machine that does nothing else; on a busy one a process gets less for each second.
    assert log(many.cpu_s / few.cpu_s) / log(50) <= 1.3, "with the square of the fleet it would be 2"
