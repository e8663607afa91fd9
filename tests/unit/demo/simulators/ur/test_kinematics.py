from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ua_demo.simulators.ur.kinematics import (
    MODELS,
    Frame,
    flange,
    frame_of,
    inverse,
    inverted,
    jacobian,
    pose_of,
    product,
    rotation_between,
    solve,
)

NO_TOOL = frame_of([0.0] * 6)
angles = st.floats(-2.5, 2.5)
joints = st.lists(angles, min_size=6, max_size=6)
poses = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6)


def flat(frame: Frame) -> list[float]:
    return [*frame.rotation, *frame.position]


@pytest.mark.parametrize(
    ("model", "q", "position"),
    [
        # All joints at zero: the arm lies stretched along -x, the flange looks along -y.
        ("ur5", [0, 0, 0, 0, 0, 0], (-0.81725, -0.19145, -0.005491)),
        ("ur5e", [0, 0, 0, 0, 0, 0], (-0.8172, -0.2329, 0.0628)),
        ("ur3e", [0, 0, 0, 0, 0, 0], (-0.45675, -0.22315, 0.0665)),
        # Upright.
        ("ur5e", [0, -math.pi / 2, 0, -math.pi / 2, 0, 0], (0.0, -0.2329, 1.0794)),
        ("ur3", [0, -math.pi / 2, 0, -math.pi / 2, 0, 0], (0.0, -0.19425, 0.69415)),
    ],
)
def test_flange_is_where_the_published_parameters_put_it(model: str, q: list[float], position: Any) -> None:
    assert flange(MODELS[model], q).position == pytest.approx(position, abs=1e-9)


@given(poses)
def test_pose_and_frame_are_the_same(pose: list[float]) -> None:
    frame = frame_of(pose)
    assert flat(frame_of(pose_of(frame))) == pytest.approx(flat(frame), abs=1e-9)


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.6, 0.8), (-0.6, 0.0, 0.8)])
def test_half_a_turn_has_a_rotation_vector(axis: tuple[float, float, float]) -> None:
    frame = frame_of([0.0, 0.0, 0.0, *[math.pi * part for part in axis]])
    assert flat(frame_of(pose_of(frame))) == pytest.approx(flat(frame), abs=1e-6)


@given(poses, poses)
def test_way_there_and_back_is_no_way(first: list[float], second: list[float]) -> None:
    there = product(frame_of(first), frame_of(second))
    assert flat(product(there, inverted(frame_of(second)))) == pytest.approx(flat(frame_of(first)), abs=1e-9)


@given(joints)
@settings(max_examples=30)
def test_jacobian_is_the_derivative_of_the_pose(q: list[float]) -> None:
    model, step = MODELS["ur5e"], 1e-6
    tip, rows = jacobian(model, q, NO_TOOL)
    for joint in range(6):
        moved = flange(model, [angle + (step if place == joint else 0.0) for place, angle in enumerate(q)])
        linear = [(after - before) / step for after, before in zip(moved.position, tip.position, strict=True)]
        angular = [angle / step for angle in rotation_between(tip, moved)]
        assert [row[joint] for row in rows] == pytest.approx([*linear, *angular], abs=1e-4)


@given(joints, st.sampled_from(sorted(MODELS)))
@settings(max_examples=30)
def test_inverse_finds_joints_for_every_pose_near_by(q: list[float], name: str) -> None:
    model, tool = MODELS[name], frame_of([0.0, 0.01, 0.1, 0.1, 0.0, 0.2])
    target = product(flange(model, q), tool)
    found = inverse(model, target, [angle + 0.05 for angle in q], tool)
    if found is None:  # a singularity is near, where Newton's method may wander off
        sine = abs(math.sin(q[4])) * abs(math.sin(q[2]))
        assert sine < 0.2 or abs(target.position[0]) < 0.2
        return
    assert flat(product(flange(model, found), tool)) == pytest.approx(flat(target), abs=1e-6)


def test_inverse_says_what_is_out_of_reach() -> None:
    assert inverse(MODELS["ur3"], frame_of([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]), [0.1] * 6, NO_TOOL) is None


def test_solve_is_least_squares() -> None:
    assert solve([[2.0, 0.0], [0.0, 4.0], [0.0, 0.0]], [2.0, 2.0, 9.0]) == pytest.approx([1.0, 0.5])
    assert solve([[1.0, 1.0]], [2.0], damping=1e-6) == pytest.approx([1.0, 1.0], abs=1e-5)
