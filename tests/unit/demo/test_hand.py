"""Where speeds bring a demonstration's robot."""

from __future__ import annotations

import math

import pytest
from ua_demo.hand import ROBOT_TIMEOUT_S, Pose


def test_a_straight_way() -> None:
    pose = Pose(1.0, 2.0)
    assert pose.go(0.5, 0.0, 10.0) == 0.0
    assert pose.go(0.0, 0.0, 12.0) == pytest.approx(1.0)
    pose.go(0.0, 0.0, 100.0)
    assert [pose.x_m, pose.y_m] == pytest.approx([2.0, 2.0])


def test_a_turn_on_the_spot_and_back() -> None:
    pose = Pose()
    pose.go(0.0, math.pi / 4, 0.0)
    pose.go(-1.0, 0.0, 2.0)
    pose.go(0.0, 0.0, 3.0)
    assert pose.heading_rad == pytest.approx(math.pi / 2)
    assert [pose.x_m, pose.y_m] == pytest.approx([0.0, -1.0])


def test_a_circle_ends_where_it_began() -> None:
    pose = Pose()
    for step in range(1001):
        pose.go(0.2, math.tau / 10, step * 0.01)
    assert [pose.x_m, pose.y_m] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert abs(pose.heading_rad) < 1e-6


@pytest.mark.parametrize("demo", ["pal", "talkrobots"])
def test_the_watch_is_that_of_the_template(demo: str) -> None:
    from importlib.resources import files

    template = files(f"ua_demo.{demo}").joinpath("fleet.template.yaml").read_text(encoding="utf-8")
    assert f"robot_timeout_ms: {ROBOT_TIMEOUT_S * 1000:.0f}" in template
