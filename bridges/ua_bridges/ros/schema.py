"""Message types: parsed from a ROS 1 definition text, or from ROS 2's dictionaries of field types.

A schema speaks the names of ROS 2, which are those on the wire, and knows under which attribute each member stands in
a message object of its own ROS. Definitions may come from anybody in the graph, so that cycles and sizes are bounded.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

from ua_bridges.ros.errors import SchemaInvalid

__all__ = [
    "Member",
    "MessageSchema",
    "canonical_type_name",
    "compact_definition",
    "ros1_type_name",
    "schema_from_definition",
    "schema_from_ros2",
]

PRIMITIVES: Final = frozenset(
    {"bool", "byte", "char", "float32", "float64", "string", "wstring"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
_MAX_MEMBERS: Final = 4096
"""Members of a type with all that it contains: a definition of a few lines can otherwise grow without end."""

_ROS2_NAMES: Final = {"boolean": "bool", "octet": "byte", "float": "float32", "double": "float64"}
"""Names in `get_fields_and_field_types` that are not those of a .msg file."""

_STANDALONE: Final = {"std_msgs/Time": "builtin_interfaces/Time", "std_msgs/Duration": "builtin_interfaces/Duration"}
_TO_ROS1: Final = {canonical: ros1 for ros1, canonical in _STANDALONE.items()}
_HEADERS: Final = frozenset({"Header", "std_msgs/Header", "roslib/Header"})

_TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)?", re.ASCII)
_MEMBER_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_ROS1_FIELD = re.compile(r"(?P<type>[A-Za-z0-9_/]+)(?P<array>\[(?P<length>[0-9]*)\])?\s+(?P<name>\S+)", re.ASCII)
_ROS2_SEQUENCE = re.compile(r"sequence<(?P<type>.+?)(,\s*(?P<bound>[0-9]+))?>", re.ASCII)
_ROS2_ARRAY = re.compile(r"(?P<type>.+)\[(?P<length>[0-9]+)\]", re.ASCII)
_ROS2_STRING = re.compile(r"(?P<type>w?string)<(?P<bound>[0-9]+)>", re.ASCII)
_SECTION = re.compile(r"^=+\s*$", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Member:
    """One member of a message type."""

    name: str
    """Name on the wire."""
    attribute: str
    """Attribute (dotted where the wire has fewer levels) in a message object."""
    type: str
    """A primitive of a .msg file, or the name of the nested type."""
    nested: MessageSchema | None = None
    array: bool = False
    length: int | None = None
    """Number of elements of a fixed array."""
    bound: int | None = None
    """Most elements of a bounded sequence."""
    text_bound: int | None = None
    """Most UTF-8 bytes of a bounded string."""
    limits: tuple[int, int] | None = None
    """What both sides can hold, where the own ROS has another integer type than the wire (the times of ROS 1)."""


@dataclass(frozen=True, slots=True)
class MessageSchema:
    """A message type with all that it contains."""

    name: str
    """`pkg/Name`, as in the property RosType."""
    native: str
    """The type's name in its own ROS (`time`, `std_msgs/Time`), for making an empty message."""
    ros: Literal[1, 2]
    members: tuple[Member, ...]
    seq_at: int | None = None
    """Of a Header of ROS 1: before which member its `seq` stands, which is none here (ROS 2 has none)."""


_INT32: Final = (1 << 31) - 1
_TIMES: Final = {
    "time": (
        "builtin_interfaces/Time",
        Member("sec", "secs", "int32", limits=(0, _INT32)),
        Member("nanosec", "nsecs", "uint32", limits=(0, 999_999_999)),
    ),
    "duration": (
        "builtin_interfaces/Duration",
        Member("sec", "secs", "int32", limits=(-_INT32 - 1, _INT32)),
        Member("nanosec", "nsecs", "uint32", limits=(0, 999_999_999)),
    ),
}
"""Built-in types of ROS 1 that are messages in ROS 2. In ROS 1 a time's seconds are a uint32."""


def canonical_type_name(ros_type: str) -> str:
    """The name that the property RosType carries, of a ROS 1 (`pkg/Name`) or ROS 2 (`pkg/msg/Name`) type name."""
    name = ros_type.replace("/msg/", "/")
    if name in _HEADERS:
        return "std_msgs/Header"
    return _STANDALONE.get(name, name)


def ros1_type_name(canonical: str) -> str:
    """The ROS 1 type that stands for a canonical name; ROS 1 has its times as `std_msgs/Time`, not as a package."""
    return _TO_ROS1.get(canonical, canonical)


def compact_definition(definition: str) -> str:
    """A ROS 1 definition without comments and empty lines; its md5 sum is the same (constants stay)."""
    lines: list[str] = []
    for line in definition.splitlines():
        constant_text = line.lstrip().startswith("string ") and "=" in line.split("#", 1)[0]
        kept = line.rstrip() if constant_text else line.split("#", 1)[0].rstrip()
        if kept:
            lines.append(kept)
    return "\n".join(lines) + "\n" if lines else ""


class _Builder:
    """Builds nested schemas of one message type, within the limits."""

    def __init__(self, ros_type: str) -> None:
        self.ros_type = ros_type
        self._open: list[str] = []
        self._members = 0

    def enter(self, name: str) -> None:
        if name in self._open:
            raise SchemaInvalid(self.ros_type, f"{name} contains itself")
        self._open.append(name)

    def leave(self) -> None:
        self._open.pop()

    def count(self) -> None:
        self._members += 1
        if self._members > _MAX_MEMBERS:
            raise SchemaInvalid(self.ros_type, f"more than {_MAX_MEMBERS} members")


def schema_from_definition(ros_type: str, definition: str) -> MessageSchema:
    """The schema of a ROS 1 type.

    Args:
        ros_type: `pkg/Name`.
        definition: the full text as in a connection header, with the types it needs after lines `MSG: pkg/Name`.

    Raises:
        SchemaInvalid: the text is no definition, or a type is missing in it.
    """
    first, *others = _SECTION.split(definition)
    sections = {ros_type: first}
    for section in others:
        head, _, body = section.lstrip().partition("\n")
        if not head.startswith("MSG:"):
            raise SchemaInvalid(ros_type, f"expected `MSG: pkg/Name` after a line of =, found {head[:40]!r}")
        sections.setdefault(head[4:].strip(), body)
    return _ros1_schema(_Builder(ros_type), ros_type, sections)


def _ros1_schema(builder: _Builder, name: str, sections: Mapping[str, str]) -> MessageSchema:
    text = sections.get(name)
    if text is None:
        raise SchemaInvalid(builder.ros_type, f"the definition of {name} is missing")
    builder.enter(name)
    members: list[Member] = []
    seq_at: int | None = None
    for line in text.splitlines():
        code = line.split("#", 1)[0].strip()
        if not code or "=" in code:  # a constant
            continue
        member = _ros1_member(builder, name, code, sections)
        if name in _HEADERS and member.name == "seq" and member.type == "uint32" and not member.array:
            seq_at = len(members)
        else:
            members.append(member)
    builder.leave()
    if len({member.name for member in members}) < len(members):
        # ROS 2 knows lower case only; a ROS 1 type whose names differ by case alone keeps them.
        members = [replace(member, name=member.attribute) for member in members]
    if name in _STANDALONE and len(members) == 1 and members[0].nested is not None:
        outer = members[0].attribute
        times = tuple(replace(time, attribute=f"{outer}.{time.attribute}") for time in members[0].nested.members)
        return MessageSchema(_STANDALONE[name], name, 1, times)
    return MessageSchema(canonical_type_name(name), name, 1, tuple(members), seq_at)


def _ros1_member(builder: _Builder, parent: str, code: str, sections: Mapping[str, str]) -> Member:
    builder.count()
    match = _ROS1_FIELD.fullmatch(code)
    if match is None or not _MEMBER_NAME.fullmatch(match["name"]) or not _TYPE_NAME.fullmatch(match["type"]):
        raise SchemaInvalid(builder.ros_type, f"{code[:60]!r} is not a member")
    kind, name = match["type"], match["name"]
    array, length = match["array"] is not None, int(match["length"]) if match["length"] else None
    nested: MessageSchema | None = None
    if kind in _TIMES:
        canonical, *times = _TIMES[kind]
        nested = MessageSchema(canonical, kind, 1, tuple(times))
    elif kind not in PRIMITIVES or kind == "wstring":
        if kind == "Header":
            kind = "std_msgs/Header"
        elif "/" not in kind:
            kind = f"{parent.split('/', 1)[0]}/{kind}"
        nested = _ros1_schema(builder, kind, sections)
    return Member(name.lower(), name, nested.name if nested else kind, nested, array, length)


def schema_from_ros2(ros_type: str, field_types: Callable[[str], Mapping[str, str]]) -> MessageSchema:
    """The schema of a ROS 2 type.

    Args:
        ros_type: `pkg/Name` or `pkg/msg/Name`.
        field_types: gives the dictionary of `get_fields_and_field_types()` of a type `pkg/Name`;
            the `__getitem__` of a dictionary will do.

    Raises:
        SchemaInvalid: a type that has no flat form (`long double`), or a type without end.
    """
    name = ros_type.replace("/msg/", "/")
    return _ros2_schema(_Builder(name), name, field_types)


def _ros2_schema(builder: _Builder, name: str, field_types: Callable[[str], Mapping[str, str]]) -> MessageSchema:
    builder.enter(name)
    try:
        types = field_types(name)
    except KeyError as error:
        raise SchemaInvalid(builder.ros_type, f"the field types of {name} are missing") from error
    members = tuple(_ros2_member(builder, member, kind, field_types) for member, kind in types.items())
    builder.leave()
    return MessageSchema(name, name, 2, members)


def _ros2_member(builder: _Builder, name: str, kind: str, field_types: Callable[[str], Mapping[str, str]]) -> Member:
    builder.count()
    length = bound = text_bound = None
    array = False
    if match := _ROS2_SEQUENCE.fullmatch(kind):
        kind, array, bound = match["type"], True, int(match["bound"]) if match["bound"] else None
    elif match := _ROS2_ARRAY.fullmatch(kind):
        kind, array, length = match["type"], True, int(match["length"])
    if match := _ROS2_STRING.fullmatch(kind):
        kind, text_bound = match["type"], int(match["bound"])
    kind = _ROS2_NAMES.get(kind, kind)
    nested: MessageSchema | None = None
    if kind not in PRIMITIVES:
        kind = kind.replace("/msg/", "/")
        if not _TYPE_NAME.fullmatch(kind) or "/" not in kind:
            raise SchemaInvalid(builder.ros_type, f"member {name} has the type {kind}, which has no flat form")
        nested = _ros2_schema(builder, kind, field_types)
    return Member(name, name, kind, nested, array, length, bound, text_bound)
