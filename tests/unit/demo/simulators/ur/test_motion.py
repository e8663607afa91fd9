from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ua_demo.simulators.ur.arm import Arm
from ua_demo.simulators.ur.kinematics import MODELS, frame_of
from ua_demo.simulators.ur.motion import MotionImpossible, Profile

DT = 0.002
READY = [0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0]
lengths = st.floats(0.001, 10.0)
rates = st.floats(0.01, 20.0)


def arm() -> Arm:
    return Arm(MODELS["ur5e"], READY)


def seconds_until_done(arm: Arm, scaling: float = 1.0, most: int = 20_000) -> float:
    steps = 0
    while arm.motion is not None:
        arm.step(DT, scaling)
        steps += 1
        assert steps < most, "the motion does not end"
    return steps * DT


@given(lengths, rates, rates)
def test_profile_covers_its_length_and_is_never_too_fast(length: float, speed: float, acceleration: float) -> None:
    profile = Profile(length, speed, acceleration)
    way_before, speed_before, step = 0.0, 0.0, profile.duration / 200
    for number in range(1, 201):
        way, now = profile.at(number * step)
        assert 0 <= way <= length * (1 + 1e-9)
        assert way >= way_before - 1e-9
        assert 0 <= now <= speed * (1 + 1e-9)
        assert abs(now - speed_before) <= acceleration * step * (1 + 1e-6) + 1e-9
        way_before, speed_before = way, now
    assert profile.at(profile.duration) == (length, 0.0)


@pytest.mark.parametrize(
    ("length", "speed", "acceleration", "duration"),
    [(1.0, 0.5, 1.0, 2.5), (0.1, 1.0, 1.0, 2 * math.sqrt(0.1)), (2.0, 1.0, 4.0, 2.25)],
)
def test_profile_takes_the_time_of_a_trapezoid_or_a_triangle(
    length: float, speed: float, acceleration: float, duration: float
) -> None:
    assert Profile(length, speed, acceleration).duration == pytest.approx(duration)


@pytest.mark.parametrize("duration", [0.5, 3.0])
def test_profile_takes_the_time_that_is_asked_for(duration: float) -> None:
    assert Profile(1.0, 99.0, 2.0, duration).duration == pytest.approx(duration)


def test_joint_move_takes_its_time_and_arrives() -> None:
    moved, target = arm(), [0.5, -1.2, 1.0, -1.5, -1.5, 0.3]
    moved.move_joints(target, 1.05, 1.4, 0.0)
    wanted = Profile(math.pi / 2 - 1.0, 1.05, 1.4).duration
    assert seconds_until_done(moved) == pytest.approx(wanted, abs=2 * DT)
    assert moved.q == target
    assert moved.qd == [0.0] * 6


def test_half_the_speed_takes_twice_the_time() -> None:
    whole, half = arm(), arm()
    for moved in (whole, half):
        moved.move_joints([1.0, *READY[1:]], 1.05, 1.4, 0.0)
    assert seconds_until_done(half, 0.5) == pytest.approx(2 * seconds_until_done(whole), abs=3 * DT)


def test_without_any_speed_nothing_moves() -> None:
    moved = arm()
    moved.move_joints([1.0, *READY[1:]], 1.05, 1.4, 0.0)
    for _ in range(100):
        moved.step(DT, 0.0)
    assert moved.q == pytest.approx(READY)
    assert moved.motion is not None


def test_linear_move_goes_straight_and_turns_evenly() -> None:
    moved = arm()
    start = moved.tcp_pose()
    target = [start[0] + 0.1, start[1], start[2] - 0.2, *start[3:]]
    moved.move_tool(frame_of(target), 0.25, 1.2, 0.0)
    length = math.hypot(0.1, 0.2)
    steps = 0
    while moved.motion is not None:
        moved.step(DT, 1.0)
        steps += 1
        x, y, z, *turn = moved.tcp_pose()
        assert y == pytest.approx(start[1], abs=1e-6)
        assert (x - start[0]) * 2 == pytest.approx(start[2] - z, abs=1e-6)
        assert turn == pytest.approx(start[3:], abs=1e-5)
        assert math.hypot(*moved.tcp_speed()[:3]) <= 0.25 * 1.01
    assert steps * DT == pytest.approx(Profile(length, 0.25, 1.2).duration, abs=2 * DT)
    assert moved.tcp_pose()[:3] == pytest.approx(target[:3], abs=1e-7)


def test_turn_on_the_spot_stays_on_the_spot() -> None:
    moved = arm()
    start = moved.tcp_pose()
    target = frame_of([*start[:3], *[angle * 0.9 for angle in start[3:]]])
    moved.move_tool(target, 0.5, 1.2, 0.0)
    seconds_until_done(moved)
    assert moved.tcp_pose() == pytest.approx([*start[:3], *[angle * 0.9 for angle in start[3:]]], abs=1e-6)


def test_linear_move_out_of_reach_is_not_begun() -> None:
    with pytest.raises(MotionImpossible, match="out of reach"):
        arm().move_tool(frame_of([3.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 0.25, 1.2, 0.0)


def test_stop_brakes_with_what_it_is_told() -> None:
    moved = arm()
    moved.speed_joints([0.8, 0.0, 0.0, 0.0, 0.0, 0.0], 2.0)
    for _ in range(500):
        moved.step(DT, 1.0)
    assert moved.qd[0] == pytest.approx(0.8)
    before = moved.q[0]
    moved.halt_joints(2.0)
    assert seconds_until_done(moved) == pytest.approx(0.4, abs=2 * DT)
    assert moved.q[0] - before == pytest.approx(0.8 * 0.8 / (2 * 2.0), abs=0.01)


def test_tool_speed_is_the_tools() -> None:
    moved = arm()
    moved.speed_tool([0.0, 0.05, 0.0, 0.0, 0.0, 0.0], 0.5)
    for _ in range(200):
        moved.step(DT, 1.0)
    assert moved.tcp_speed() == pytest.approx([0.0, 0.05, 0.0, 0.0, 0.0, 0.0], abs=1e-4)


def test_servo_is_where_it_shall_be_in_time() -> None:
    moved = arm()
    target = [READY[0] + 0.01, *READY[1:]]
    moved.servo(target, 0.02)
    for _ in range(10):
        moved.step(DT, 1.0)
    assert moved.q == pytest.approx(target, abs=1e-6)
