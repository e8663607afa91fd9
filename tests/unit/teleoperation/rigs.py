"""A robot to drive in tests, without a bridge."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count

from ua_fleet.teleoperation import AxisLimits, Control, SetpointAddress, TeleoperationModel
from ua_fleet.topics import Topic

LINEAR = AxisLimits(speed=0.5, acceleration=0.5, deceleration=1.0, jerk=2.0)
ANGULAR = AxisLimits(speed=1.0, acceleration=2.0, deceleration=2.0, jerk=8.0)


def model(
    limits: Sequence[AxisLimits] = (LINEAR, ANGULAR),
    *,
    deadman_s: float = 0.3,
    robot_timeout_s: float = 0.5,
    period_s: float = 0.02,
) -> TeleoperationModel:
    return TeleoperationModel(
        "carrier",
        Topic(0, 2, 1002),
        tuple((f"axis{number}", each) for number, each in enumerate(limits)),
        Topic(2, 2, 1003),
        SetpointAddress(1001, 1003),
        Topic(2, 2, 1004),
        Topic(2, 2, 1005),
        Topic(2, 2, 1006),
        deadman_s,
        robot_timeout_s,
        period_s,
    )


def control(of: TeleoperationModel | None = None, first: int = 1) -> Control:
    numbers = count(first)
    return Control(of or model(), lambda: next(numbers))
