"""Mapped topics held against installed message types: of ROS 1 and ROS 2, made as their generators make them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from ua_bridges.ros import installed
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_bridges.ros.type_checks import message_type_findings

from ua_fleet.config.schema import DataSetConfig, RobotConfig

ODOMETRY = """float64[36] covariance
string child_frame_id
std_msgs/Header header
geometry_msgs/Point position
geometry_msgs/Point[] path
float32[] ranges
uint8[] image
bool moving
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
"""
FIELDS = {
    "nav_msgs/Odometry": {
        "covariance": "double[36]",
        "child_frame_id": "string",
        "header": "std_msgs/Header",
        "position": "geometry_msgs/Point",
        "path": "sequence<geometry_msgs/Point>",
        "ranges": "sequence<float>",
        "image": "sequence<uint8>",
        "moving": "boolean",
    },
    "std_msgs/Header": {"stamp": "builtin_interfaces/Time", "frame_id": "string"},
    "builtin_interfaces/Time": {"sec": "int32", "nanosec": "uint32"},
    "geometry_msgs/Point": {"x": "double", "y": "double"},
}


@pytest.fixture(params=[1, 2], autouse=True)
def ros(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Literal[1, 2]]:
    """A folder with the packages of one ROS, and no other."""
    if request.param == 1:
        folder = tmp_path / "nav_msgs" / "msg"
        folder.mkdir(parents=True)
        (folder / "__init__.py").write_text("from ._Odometry import *\n")
        (folder / "_Odometry.py").write_text(f"class Odometry:\n  _full_text = {ODOMETRY!r}\n")
    else:
        for name, members in FIELDS.items():
            package, _, kind = name.partition("/")
            folder = tmp_path / package / "msg"
            folder.mkdir(parents=True)
            (folder / "__init__.py").write_text(f"from {package}.msg._{kind.lower()} import {kind}  # noqa: F401\n")
            (folder / f"_{kind.lower()}.py").write_text(f"class {kind}:\n    _fields_and_field_types = {members!r}\n")

    def folders_of(_: int) -> list[Path]:
        return [tmp_path]

    monkeypatch.setattr(installed, "folders_of", folders_of)
    installed.schema_of.cache_clear()
    installed.types_of.cache_clear()
    yield request.param
    installed.schema_of.cache_clear()
    installed.types_of.cache_clear()


def found(ros: Literal[1, 2], data: dict[str, Any]) -> list[tuple[str, str, str, bool]]:
    """What is said of one data source, which is read from an Odometry where nothing else is said."""
    whole = {"source": {"topic": "/odom", "type": "nav_msgs/Odometry"}, **data}
    sides = {side: TopicMapping.model_validate(whole.pop(side)) for side in ("source", "sink") if whole.get(side)}
    whole.pop("source", None)
    dataset = DataSetConfig.model_validate(whole).model_copy(update=sides)
    robots = {"carrier": RobotConfig(bridge="floor").model_copy(update={"data": {"odom": dataset}})}
    return [
        (".".join(map(str, path[4:])), one.text, one.suggestion, one.is_doubt)
        for path, one in message_type_findings(robots, "floor", ros)
    ]


@pytest.mark.parametrize(
    "data",
    [
        {"type": "Double", "path": "position.x"},
        {"type": "Double", "path": "covariance[35]"},
        {"type": "Float", "array": True, "path": "ranges"},
        {"type": "Double", "path": "path[2].x"},
        {"type": "ByteString", "path": "image"},
        {"type": "Boolean", "path": "moving"},
        {"type": "DateTime", "path": "header.stamp"},
        {"fields": {"child_frame_id": {"type": "String"}, "y": {"type": "Float", "path": "position.y"}}},
    ],
)
def test_what_a_message_has_is_right(ros: Literal[1, 2], data: dict[str, Any]) -> None:
    assert found(ros, data) == []


@pytest.mark.parametrize(
    ("data", "where", "text", "hint"),
    [
        (
            {"type": "Double", "path": "position.z"},
            "path",
            "nav_msgs/Odometry has no field position.z",
            "`position.x`, `position.y`",
        ),
        ({"type": "Double", "path": "posiiton.x"}, "path", "no field posiiton", "did you mean `position.x`?"),
        ({"type": "Double"}, "", "nav_msgs/Odometry has no field data", "it has: "),
        ({"type": "Double", "path": "covariance[36]"}, "path", "the last is [35]", ""),
        ({"type": "Double", "path": "position"}, "path", "a message of type geometry_msgs/Point", "`position.x`"),
        ({"type": "Double", "path": "position[0]"}, "path", "position is no array", "leave [0] out"),
        ({"type": "Double", "path": "covariance"}, "path", "is an array of float64", "add `array: true`"),
        ({"type": "Double", "array": True, "path": "position.x"}, "path", "is a single float64", "remove `array`"),
        ({"type": "Double", "path": "child_frame_id"}, "path", "is a string", "give `type: String`"),
        ({"type": "String", "path": "position.x"}, "path", "is a float64", "give `type: Double`"),
        ({"type": "Double", "path": "header.stamp"}, "path", "header.stamp is a time", "give `type: DateTime`"),
        ({"type": "Double", "array": True, "path": "path.x"}, "path", "is an array of messages", "such as path[0]"),
        ({"fields": {"childframe": {"type": "String"}}}, "fields.childframe", "no field childframe", "child_frame_id"),
    ],
)
def test_what_a_message_has_not_is_told(
    ros: Literal[1, 2], data: dict[str, Any], where: str, text: str, hint: str
) -> None:
    ((key, said, suggestion, is_doubt),) = found(ros, data)
    assert (key, is_doubt) == (where, False)
    assert text in said
    assert hint in suggestion


def test_a_type_that_its_package_has_not(ros: Literal[1, 2]) -> None:
    wrong = {"topic": "/odom", "type": "nav_msgs/msg/Odometri"}
    ((key, said, suggestion, is_doubt),) = found(ros, {"type": "Double", "path": "position.x", "source": wrong})
    assert (key, is_doubt) == ("source.type", False)
    assert said == f"nav_msgs has no message type nav_msgs/Odometri in ROS {ros}"
    assert suggestion.startswith("did you mean `nav_msgs/Odometry`?")


def test_of_a_package_that_is_not_here_nothing_is_known(ros: Literal[1, 2]) -> None:
    other = {"topic": "/odom", "type": "nav_mesh/Odometry"}
    ((key, said, _, is_doubt),) = found(ros, {"type": "Double", "path": "position.x", "source": other})
    assert (key, is_doubt) == ("source.type", True)
    assert said == f"messages of nav_mesh for ROS {ros} are not installed here: nav_mesh/Odometry was not looked at"


def test_a_sink_writes_places_that_a_message_has(ros: Literal[1, 2]) -> None:
    sink = {"topic": "/odom", "type": "nav_msgs/Odometry"}
    right = {"origin": "server", "source": None, "sink": sink, "type": "Double", "path": "position.x"}
    assert found(ros, right) == []
    ((key, said, suggestion, is_doubt),) = found(ros, {**right, "path": "position.z"})
    assert (key, is_doubt) == ("path", False)
    assert "has no field 'z'" in said
    assert "`position.x`" in suggestion


def test_messages_of_each_ros_are_looked_for_beside_the_other_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever of the two environments asks."""
    monkeypatch.undo()
    for prefix in ("/x/.venv", "/x/.venv-ros1"):
        monkeypatch.setattr(sys, "prefix", prefix)
        asked: list[str] = []

        def glob(self: Path, pattern: str, asked: list[str] = asked) -> list[Path]:
            asked.append(str(self))
            return []

        monkeypatch.setattr(Path, "glob", glob)
        installed.folders_of(1)
        installed.folders_of(2)
        assert asked[0] == "/x/.venv-ros1"
        assert "/x/.venv" in asked
