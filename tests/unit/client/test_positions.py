"""Which data say where a robot is, by their names."""

from __future__ import annotations

import math

import pytest

from ua_fleet.client.positions import find_position, yaw_of

Path = tuple[str, ...]


def found(*names: str) -> tuple[str, ...]:
    """What is found among paths that are written with slashes: x, y, heading, orientation and frame."""
    x, y, heading, orientation, frame = find_position([tuple(name.split("/")) for name in names])
    return tuple("/".join(one) if one else "" for one in (x, y, heading or (), *(orientation or ((),)), frame or ()))


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["pose/x", "pose/y"], ("pose/x", "pose/y", "", "", "")),
        (["pose/x", "pose/y", "pose/yaw", "pose/frame"], ("pose/x", "pose/y", "pose/yaw", "", "pose/frame")),
        (["position/x", "position/y", "pose/x", "pose/y"], ("position/x", "position/y", "", "", "")),
        (["Pose/X", "Pose/Y", "Pose/Theta"], ("Pose/X", "Pose/Y", "Pose/Theta", "", "")),
        (["base/pose/x", "base/pose/y"], ("base/pose/x", "base/pose/y", "", "", "")),
        (["pose/x"], ("", "", "", "", "")),
        (["twist/x", "twist/y", "box/x", "box/y", "pose/goal.x", "pose/goal.y"], ("", "", "", "", "")),
        (["pose.x", "pose.y"], ("pose.x", "pose.y", "", "", "")),
        (["x", "y"], ("", "", "", "", "")),
    ],
)
def test_names(names: list[str], expected: tuple[str, ...]) -> None:
    assert found(*names) == expected


def test_messages_of_ros_as_they_are() -> None:
    odometry = [
        *("header.frame_id", "child_frame_id", "twist.twist.linear.x", "twist.twist.linear.y"),
        *(f"pose.pose.position.{axis}" for axis in "xyz"),
        *(f"pose.pose.orientation.{axis}" for axis in "xyzw"),
    ]
    assert found(*(f"odom/{name}" for name in odometry)) == (
        "odom/pose.pose.position.x",
        "odom/pose.pose.position.y",
        "",
        *(f"odom/pose.pose.orientation.{axis}" for axis in "xyzw"),
        "odom/header.frame_id",
    )
    stamped = ("pose.position.x", "pose.position.y", "pose.orientation.z", "pose.orientation.w", "header.frame_id")
    x, y, z, w, frame = (f"where/{name}" for name in stamped)
    assert found(x, y, z, w, frame) == (x, y, "", z, w, frame)


def test_half_an_orientation_is_none() -> None:
    assert found("pose/x", "pose/y", "pose/orientation.z") == ("pose/x", "pose/y", "", "", "")
    assert found("pose/x", "pose/y", "pose/orientation.z", "pose/orientation.w")[3:5] == (
        "pose/orientation.z",
        "pose/orientation.w",
    )


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5, math.pi / 2])
def test_quaternions(yaw: float) -> None:
    z, w = math.sin(yaw / 2), math.cos(yaw / 2)
    for told in (yaw_of((z, w)), yaw_of((0.0, 0.0, z, w)), yaw_of((0.0, 0.0, 3 * z, 3 * w))):
        assert told == pytest.approx(yaw)


def test_what_is_no_rotation() -> None:
    assert yaw_of((0.0, 0.0)) is None
    assert yaw_of((math.nan, 1.0)) is None
    assert yaw_of((0.0, 0.0, math.inf, 1.0)) is None
