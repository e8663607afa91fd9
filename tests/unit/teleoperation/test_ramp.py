"""The ramp keeps to speed, acceleration and jerk, meets its target and stops in the time that is promised."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.teleoperation.model import AxisLimits
from ua_fleet.teleoperation.ramp import AxisRamp, Ramp

LIMIT = st.floats(0.05, 20.0)
LIMITS = st.builds(AxisLimits, LIMIT, LIMIT, LIMIT, st.floats(0.05, 200.0))
PERIODS = st.sampled_from([0.005, 0.01, 0.02, 0.05, 0.1])
WISHES = st.lists(st.tuples(st.floats(-1.5, 1.5), st.integers(1, 60)), max_size=8)
"""Parts of the greatest speed, also beyond it, and for how many periods each is wished."""


class Profile:
    """What an axis does, each period held against its limits."""

    def __init__(self, limits: AxisLimits, period_s: float) -> None:
        self.limits, self.period_s, self.axis = limits, period_s, AxisRamp(limits, period_s)
        self.values = [0.0]

    def go(self, target: float | None) -> None:
        limits, axis, before = self.limits, self.axis, (self.axis.value, self.axis.slope)
        most = limits.acceleration
        if target is None:
            axis.brake()
            most = limits.deceleration
        else:
            axis.follow(target)
        step = limits.jerk * self.period_s
        nearly = 1 + 1e-6
        assert abs(axis.slope - before[1]) <= step * nearly
        assert abs(axis.slope) <= max(most, abs(before[1]) - step) * nearly + 1e-12
        assert abs(axis.value - before[0]) <= abs(axis.slope) * self.period_s * nearly + 2e-9 * limits.speed
        assert abs(axis.value) <= limits.speed * nearly
        self.values.append(axis.value)


@given(limits=LIMITS, period_s=PERIODS, wishes=WISHES)
def test_each_period_keeps_to_the_limits_and_a_stop_to_its_time(
    limits: AxisLimits, period_s: float, wishes: list[tuple[float, int]]
) -> None:
    profile = Profile(limits, period_s)
    for part, periods in wishes:
        for _ in range(periods):
            profile.go(part * limits.speed)
    within = math.ceil(limits.stop_s / period_s) + 2
    for _ in range(within):
        profile.go(None)
    assert profile.axis.is_at_rest
    profile.go(None)
    assert profile.axis.value == 0.0


@given(limits=LIMITS, period_s=PERIODS, part=st.floats(-1.0, 1.0))
def test_a_target_is_met_from_rest_without_passing_it(limits: AxisLimits, period_s: float, part: float) -> None:
    target = part * limits.speed
    profile = Profile(limits, period_s)
    periods = math.ceil((abs(target) / limits.acceleration + 2 * limits.acceleration / limits.jerk) / period_s) + 3
    for _ in range(periods):
        profile.go(target)
    assert profile.axis.value == target
    assert profile.axis.slope == 0.0
    beyond = [value for value in profile.values if abs(value) > abs(target) * (1 + 1e-9) or value * target < 0]
    assert not beyond
    assert [abs(value) for value in profile.values] == sorted(abs(value) for value in profile.values)


def test_what_the_profile_is() -> None:
    """0.5 m/s with 0.5 m/s2 and 2 m/s3: the slope is built up in 0.25 s, held, and let go in 0.25 s."""
    axis = AxisRamp(AxisLimits(0.5, 0.5, 1.0, 2.0), 0.05)
    slopes: list[float] = []
    while axis.value < 0.5:
        axis.follow(2.0)
        slopes.append(round(axis.slope, 6))
    assert slopes == [0.1, 0.2, 0.3, 0.4, *[0.5] * 16, 0.4, 0.3, 0.2, 0.1]
    axis.follow(2.0)
    assert (axis.value, axis.slope) == (0.5, 0.0)


def test_a_robot_that_has_stopped_by_itself_is_at_rest_at_once() -> None:
    ramp = Ramp([AxisLimits(1, 1, 1, 10)] * 2, 0.02)
    for _ in range(20):
        ramp.follow((1.0, -1.0))
    assert not ramp.is_at_rest
    ramp.rest()
    assert (ramp.values, ramp.is_at_rest) == ((0.0, 0.0), True)
