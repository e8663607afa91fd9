"""The benchmark `teleoperation`: its fleet, and which callback of the robot belongs to which press."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.harness import Failed
from benchmarks.teleoperation import arrivals, write_fleet
from ua_fleet.config.teleoperation import teleoperations

HELD = [(0.00, 0.2), (0.02, 0.2), (0.04, 0.2)]


def test_a_press_arrives_with_the_first_other_speed() -> None:
    speeds = [*HELD, (0.06, 0.21), (0.08, 0.24), (0.10, 0.25), (0.12, 0.25), (0.14, 0.24), (0.16, 0.2)]
    assert arrivals([(0.05, 0.25), (0.11, 0.2)], speeds) == [pytest.approx(0.01), pytest.approx(0.03)]


def test_one_that_never_arrives_is_a_failure() -> None:
    with pytest.raises(Failed, match=r"a press for a speed of 0\.25 did not come to the robot, which has 0\.2"):
        arrivals([(0.05, 0.25)], [*HELD, (0.06, 0.2), (3.0, 0.25)])
    with pytest.raises(Failed, match="did not come"):
        arrivals([(0.05, 0.25)], HELD)


def test_one_that_goes_the_other_way_is_a_failure() -> None:
    with pytest.raises(Failed, match="did not come"):
        arrivals([(0.05, 0.25)], [*HELD, (0.06, 0.15)])


def test_its_file_is_one(tmp_path: Path) -> None:
    (model,) = teleoperations(write_fleet(tmp_path / "fleet.yaml", 7, 4840), "floor")
    assert model.robot == "carrier"
