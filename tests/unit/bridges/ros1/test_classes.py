# pyright: basic, reportMissingImports=false
from __future__ import annotations

import copy
import io
import sys

import pytest

pytest.importorskip("genpy", reason="needs the Python that has rospy")

from ua_bridges.ros1.classes import (
    CACHED_TYPES,
    TypeUnavailable,
    installed_type,
    sanitized,
    type_from_definition,
    type_of_publisher,
)

BAR = "=" * 80
CUSTOM = f"""# What a comment holds does not matter: \\u \"\"\" C:\\Users
Header header
uint8 IDLE=0
float32 LIMIT=-1.5e3  # a constant
string NAME=it's a "name" \\
Part[] parts
time since
{BAR}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{BAR}
MSG: acme_msgs/Part
float64[3] position
string label
"""


@pytest.mark.parametrize(
    "name",
    ["std_msgs/Float64", "std_msgs/Time", "sensor_msgs/JointState", "sensor_msgs/CameraInfo", "geometry_msgs/Twist"],
)
def test_class_made_of_a_definition_has_the_md5sum_of_the_installed_one(name: str) -> None:
    installed = installed_type(name)
    assert installed is not None
    assert type_from_definition(name, installed.definition).md5sum == installed.md5sum


def test_class_of_a_type_that_is_not_installed_reads_what_it_wrote() -> None:
    kind = type_from_definition("acme_msgs/Task", CUSTOM)
    message = kind.cls()
    part = kind.make("acme_msgs/Part")
    part.position, part.label = [1.0, 2.0, 3.0], "screw"
    message.parts = [part]
    message.since = kind.make("time")
    buffer = io.BytesIO()
    message.serialize(buffer)
    again = kind.cls().deserialize(buffer.getvalue())
    assert (again.parts[0].position, again.parts[0].label) == ((1.0, 2.0, 3.0), "screw")
    assert type_from_definition("acme_msgs/Task", CUSTOM) is kind


@pytest.mark.parametrize(
    "line",
    [
        "int8 X;__import__('os');Y=5",
        "int8 print('x')=1",
        "bool A=exit",
        "int8[len('a')] a",
        "float64 a b",
        "float64 a()",
        "float64 ä",
        "MSG: a/b/c",
        "MSG: x;y",
        "float64[99999999] a",
    ],
)
def test_definition_with_more_in_it_than_declarations_is_refused(line: str) -> None:
    with pytest.raises(TypeUnavailable):
        type_from_definition("acme_msgs/Evil", line)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("acme_msgs/A", "B b\n"),
        ("acme_msgs/A", "A a\n"),
        ("acme_msgs/A", "float64 a\n" * 10_000),
        ("../A", "float64 a\n"),
        ("A", "float64 a\n"),
    ],
)
def test_definition_that_makes_no_class_is_refused(name: str, text: str) -> None:
    with pytest.raises(TypeUnavailable):
        type_from_definition(name, text)


def test_what_is_left_of_a_definition() -> None:
    assert sanitized(CUSTOM).splitlines()[:5] == [
        "Header header",
        "uint8 IDLE=0",
        "float32 LIMIT=-1.5e3",
        "Part[] parts",
        "time since",
    ]


@pytest.mark.parametrize("name", ["antigravity/This", "os/path", "std_msgs/Nothing", "nowhere_msgs/A", "no type"])
def test_nothing_is_imported_that_is_no_message_package(name: str) -> None:
    assert installed_type(name) is None


def test_installed_class_is_taken_only_when_it_is_the_publishers() -> None:
    installed = installed_type("std_msgs/Float64")
    assert installed is not None
    assert type_of_publisher("std_msgs/Float64", installed.md5sum, installed.definition) is installed
    other = type_of_publisher("std_msgs/Float64", "0" * 32, "float64 data\nint32 more\n")
    assert other.cls.__slots__ == ["data", "more"]


def test_types_without_number_take_nobodys_place_and_leave_nothing_behind() -> None:
    modules, folders = len(sys.modules), list(sys.path)
    kept = type_from_definition("acme_msgs/Kept", "float64 x\n")
    for number in range(CACHED_TYPES + 50):
        kind = type_from_definition("acme_msgs/Many", f"int8 x{number}\n")
        message = kind.cls()
        assert getattr(message.deserialize(b"\x07"), f"x{number}") == 7
    assert len(sys.modules) - modules < 5
    assert sys.path == folders
    assert copy.deepcopy(kept.cls().deserialize(bytes(8))).x == 0.0


def test_definition_of_too_many_types_is_refused_at_once() -> None:
    line = "=" * 80
    many = "".join(f"{line}\nMSG: acme_msgs/A{number}\nint8 x\n" for number in range(600))
    text = "".join(f"A{number} a{number}\n" for number in range(600)) + many
    with pytest.raises(TypeUnavailable, match="more than 100 types"):
        type_from_definition("acme_msgs/Thing", text)
