"""A robot's own topic that a DataSet is written to: values into configured places of a message."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from ua_bridges.ros.convert import Assign, Writer, setter
from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.leaves import OCTETS
from ua_bridges.ros.scalars import Convert, array_writer, octets_writer, scalar_writer
from ua_bridges.ros.schema import Member, MessageSchema
from ua_fleet.values import unix_ns_from_ticks

__all__ = ["compile_sink"]

_STEP = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\[(\d{1,6})\])?", re.ASCII)
_TIME = "builtin_interfaces/Time"


def _find(schema: MessageSchema, path: str) -> tuple[str, Member, int | None]:
    """The attribute path, the member and the index that `twist.linear.x` or `position[2]` means in a type."""
    attributes: list[str] = []
    parts = path.split(".")
    for position, part in enumerate(parts):
        step = _STEP.fullmatch(part)
        if step is None:
            raise ConversionError(path, "not the path of a field; write it like `twist.linear.x` or `position[2]`")
        member = next((m for m in schema.members if step[1] in (m.name, m.attribute)), None)
        if member is None:
            raise ConversionError(path, f"{schema.name} has no field {step[1]!r}; correct `path`")
        attributes.append(member.attribute)
        index = None if step[2] is None else int(step[2])
        if position == len(parts) - 1:
            return ".".join(attributes), member, index
        if member.nested is None or member.array:
            raise ConversionError(path, f"{step[1]!r} is no single message; correct `path`")
        schema = member.nested
    raise AssertionError("a path has at least one part")


def _check_place(schema: MessageSchema, path: str, member: Member, index: int | None) -> None:
    if member.nested is not None and (member.array or member.nested.name != _TIME):
        raise ConversionError(path, f"a {member.type} of {schema.name} is no single value; name one of its fields")
    if index is None:
        return
    if not member.array:
        raise ConversionError(path, "there is no array; leave the index out of `path`")
    if member.type in OCTETS:
        raise ConversionError(path, "bytes are written as one ByteString; leave the index out of `path`")
    most = member.length if member.length is not None else member.bound
    if most is not None and index >= most:
        raise ConversionError(path, f"the array has {most} elements")


def _time_setter(path: str, member: Member) -> Assign:
    assert member.nested is not None
    setters = [(setter(f"{path}.{part.attribute}"), scalar_writer(part, 1)) for part in member.nested.members]

    def assign(message: Any, unix_ns: int) -> None:
        for (assign_part, convert), number in zip(setters, divmod(unix_ns, 1_000_000_000), strict=True):
            assign_part(message, convert(number))

    return assign


def _ticks(value: Any) -> int:
    if type(value) is not int:
        raise TypeError(f"a {type(value).__name__} is not a DateTime")
    unix_ns = unix_ns_from_ticks(value)
    if not 0 <= unix_ns < (1 << 31) * 1_000_000_000:
        raise OverflowError("the time does not fit into the seconds of ROS")
    return unix_ns


def compile_sink(schema: MessageSchema, fields: Sequence[tuple[str, str]]) -> Writer:
    """A function that puts values into places of a message; what is not named keeps what the message has there.

    A DateTime may go into a time. Elements named with an index (`position[2]`) make an array as long as its type says,
    else up to the highest index named, with zeros (or empty strings) between.

    Args:
        schema: the type of the message objects.
        fields: the name of each value, in their order, and the path of its place.

    The function raises ConversionError, which names the field, and then leaves the message as it was.

    Raises:
        ConversionError: a path that the type does not have, with what to correct.
    """
    singles: list[tuple[int, str, Convert, Assign]] = []
    arrays: dict[str, tuple[Member, list[tuple[int, int]]]] = {}
    for position, (name, path) in enumerate(fields):
        attribute, member, index = _find(schema, path)
        _check_place(schema, path, member, index)
        if index is not None:
            arrays.setdefault(attribute, (member, []))[1].append((index, position))
        elif member.nested is not None:
            singles.append((position, name, _ticks, _time_setter(attribute, member)))
        else:
            convert = scalar_writer(member, schema.ros)
            if member.array:
                octets = member.type in OCTETS
                convert = octets_writer(member, schema.ros) if octets else array_writer(member, schema.ros, name)
            singles.append((position, name, convert, setter(attribute)))
    indexed = [
        (places, _blank(member, places), array_writer(member, schema.ros, attribute), setter(attribute))
        for attribute, (member, places) in arrays.items()
    ]
    names = [name for name, _ in fields]

    def write(message: Any, values: Sequence[Any]) -> None:
        if len(values) != len(names):
            raise ConversionError("*", f"{len(values)} values for {len(names)} fields")
        converted: list[tuple[Assign, Any]] = []
        for position, name, convert, assign in singles:
            try:
                converted.append((assign, convert(values[position])))
            except (TypeError, ValueError, OverflowError) as error:
                raise ConversionError(name, str(error)) from error
        for places, blank, convert, assign in indexed:
            elements = list(blank)
            for index, position in places:
                elements[index] = values[position]
            converted.append((assign, convert(elements)))
        for assign, value in converted:
            assign(message, value)

    return write


def _blank(member: Member, places: Sequence[tuple[int, int]]) -> list[Any]:
    count = member.length if member.length is not None else max(index for index, _ in places) + 1
    zero = "" if member.type.endswith("string") else False if member.type == "bool" else 0
    return [zero] * count
