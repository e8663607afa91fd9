"""Eq. 1 to 12 give the figures that the paper prints."""

from dataclasses import replace
from typing import Any

import pytest
from ua_demo import equations
from ua_demo.equations import EQUATION_12_KINDS, Situation, cyclic, equation_12_sum

from ua_fleet.errors import ScenarioError
from ua_fleet.traffic import MessageKind, Traffic

DEMONSTRATION = Situation(robots=5, sensor_rates=(1.0,), elapsed_s=180.0)
"""Section 6.2: five robots, one sensor that says something each second, about three minutes."""
BEST = replace(DEMONSTRATION, direct_tasks=9, blocks=(9,), local_requests=1)
WORST = replace(DEMONSTRATION, interpreted_tasks=9, blocks=(1,) * 9, remote_requests=1, faulty_robots=1)


def test_the_best_case_of_the_demonstration() -> None:
    assert equations.total(BEST) == 251


def test_the_worst_case_with_its_faulty_robot_is_two_more_than_printed() -> None:
    assert equations.total(WORST) == 299


def test_the_worst_case_as_printed_leaves_the_faulty_robot_out() -> None:
    assert equations.total(replace(WORST, faulty_robots=0)) == 297


def test_what_was_measured_stands_between_the_cases() -> None:
    assert equations.total(BEST) < 284 < equations.total(WORST)


def test_figure_9() -> None:
    assert equations.forward(Situation(3, direct_tasks=12, blocks=(2, 2, 3))) == 7
    assert equations.forward(Situation(3, direct_tasks=12, blocks=(2, 2, 3, 1, 1, 1, 1, 1))) == 7


def test_50_robots_and_100_tasks() -> None:
    assert equations.total(cyclic(50, 100)) == 1925


@pytest.mark.parametrize("robots", [1, 2, 5, 50, 1000])
@pytest.mark.parametrize("tasks", [1, 9, 100])
def test_the_parts_add_up_to_the_printed_closed_forms(robots: int, tasks: int) -> None:
    case = replace(
        cyclic(robots, tasks, min(1, robots - 1)),
        interpreted_tasks=4,
        sensor_rates=(1.0, 0.5),
        elapsed_s=60.0,
        local_requests=2,
        remote_requests=3,
    )
    updates = 60 * 1.5
    assert equations.start(case) == (robots * (robots + 7) + 4 * 2 + 2 + 2 * updates) / 2  # Eq. 4
    gaps = len(case.blocks) - sum(case.blocks)
    assert equations.scenario(case) == 5 * tasks + 9 * 4 + gaps - 1  # Eq. 9
    assert equations.total(case) == (  # Eq. 12
        robots * (robots + 7) / 2 + 2 * (2 + 2 + 2 * 3 + case.faulty_robots) + 5 * tasks + 9 * 4 + updates + gaps
    )


def test_one_robot_hands_nothing_over() -> None:
    assert equations.forward(cyclic(1, 100)) == 0


def test_no_task_is_not_handed_over() -> None:
    assert equations.forward(cyclic(5, 0)) == 0


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ({"robots": 0}, "one robot at least"),
        ({"robots": 2, "direct_tasks": -1}, "no count below 0"),
        ({"robots": 2, "faulty_robots": 2}, "at most 1"),
        ({"robots": 2, "direct_tasks": 2, "blocks": (3,)}, "no more than the scenario"),
        ({"robots": 2, "direct_tasks": 2, "blocks": (0,)}, "one task at least"),
    ],
)
def test_what_cannot_be(case: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        Situation(**case)


def test_what_equation_12_counts() -> None:
    traffic = Traffic()
    for number, kind in enumerate(MessageKind):
        traffic.record(kind, 10**number, 0.0)
    counted = {kind for kind in MessageKind if kind in EQUATION_12_KINDS}
    assert counted == set(MessageKind) - {
        MessageKind.METADATA,
        MessageKind.KEEP_ALIVE,
        MessageKind.REPEAT,
        MessageKind.TELEMETRY,
        MessageKind.SENSOR,
        MessageKind.RUN,
    }
    assert equation_12_sum(traffic.messages) == 6
    assert equation_12_sum(traffic.bytes) == 1111101
