"""Single values between ROS and the wire: one checked conversion for each primitive of a .msg file.

rclpy checks nothing by itself: an int in a float64 member or a number out of range is sent as other bytes, in silence.
So every value is checked here, and becomes exactly the Python type that the generated code of both ROS expects.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, TypeGuard

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.schema import Member

__all__ = [
    "LIMITS",
    "TYPECODES",
    "Convert",
    "array_writer",
    "check_length",
    "integer",
    "is_array",
    "octets_reader",
    "octets_writer",
    "scalar_writer",
]

Convert = Callable[[Any], Any]
"""Gives the converted value, or raises TypeError, ValueError or OverflowError with the reason."""

LIMITS: Final = {
    f"{sign}int{bits}": (-(1 << bits - 1), (1 << bits - 1) - 1) if not sign else (0, (1 << bits) - 1)
    for bits in (8, 16, 32, 64)
    for sign in ("", "u")
} | {"char": (0, 255), "byte": (0, 255)}
"""Least and greatest value of the integer types."""

TYPECODES: Final = {
    "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q",
    "float32": "f", "float64": "d",
}  # fmt: skip
"""Type codes of the standard library's `array`, the same that rclpy uses."""

_MAX_FLOAT32: Final = 3.4028234663852886e38
"""Greatest finite value of an IEEE 754 single."""


def integer(least: int, greatest: int) -> Convert:
    """Checks an integer; a float without a fraction is one."""

    def convert(value: Any) -> int:
        if type(value) is not int:
            if not isinstance(value, float):
                raise TypeError(f"a {type(value).__name__} is not an integer")
            if not value.is_integer():
                raise ValueError(f"{value} is not an integer")
            value = int(value)
        if not least <= value <= greatest:
            raise OverflowError(f"{value} is not within {least}..{greatest}")
        return value  # type: ignore[no-any-return]  # an int by the checks above

    return convert


def _float64(value: Any) -> float:
    if type(value) is float:
        return value
    if type(value) is not int:
        raise TypeError(f"a {type(value).__name__} is not a number")
    return float(value)


def _float32(value: Any) -> float:
    number = _float64(value)
    if abs(number) > _MAX_FLOAT32 and not math.isinf(number):
        raise OverflowError(f"{number} does not fit into a float32")
    return number


def _bool(value: Any) -> bool:
    if value is True or value is False:
        return value
    raise TypeError(f"a {type(value).__name__} is not a bool")


def _text(bound: int | None, ros: Literal[1, 2]) -> Convert:
    def convert(value: Any) -> str:
        if value is None:  # a null String
            return ""
        if type(value) is not str:
            raise TypeError(f"a {type(value).__name__} is not a string")
        if bound is not None and len(value.encode()) > bound:
            raise ValueError(f"the string is longer than {bound}")
        if ros == 2 and "\0" in value:
            raise ValueError("a string of ROS 2 ends at its first NUL character")
        return value

    return convert


def _byte(ros: Literal[1, 2]) -> Convert:
    number = integer(0, 255)

    def to_ros1(value: Any) -> int:
        octet: int = number(value)
        return octet - 256 if octet > 127 else octet

    def to_ros2(value: Any) -> bytes:
        return bytes((number(value),))

    return to_ros1 if ros == 1 else to_ros2


def scalar_writer(member: Member, ros: Literal[1, 2]) -> Convert:
    """Checks one value for a member (or an element) of a primitive type."""
    kind = member.type
    if member.limits is not None:
        return integer(*member.limits)
    if kind == "byte":
        return _byte(ros)
    if kind in LIMITS:
        return integer(*LIMITS[kind])
    if kind == "bool":
        return _bool
    if kind == "float64":
        return _float64
    return _float32 if kind == "float32" else _text(member.text_bound, ros)


def is_array(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether a value from the wire (or from parsed JSON) is an array."""
    return isinstance(value, tuple | list | memoryview)


def check_length(count: int, member: Member) -> None:
    """Raise ValueError unless an array member may have so many elements."""
    if member.length is not None and count != member.length:
        raise ValueError(f"{count} elements, the type has {member.length}")
    if member.bound is not None and count > member.bound:
        raise ValueError(f"{count} elements, the type has at most {member.bound}")


def _each(values: Sequence[Any], convert: Convert, field: str) -> list[Any]:
    converted: list[Any] = []
    for index, value in enumerate(values):
        try:
            converted.append(convert(value))
        except (TypeError, ValueError, OverflowError) as error:
            raise ConversionError(f"{field}[{index}]", str(error)) from error
    return converted


def array_writer(member: Member, ros: Literal[1, 2], field: str) -> Convert:
    """Checks an array of a primitive type: an `array` for rclpy's sequences, else a list of exact types."""
    convert, typecode = scalar_writer(member, ros), TYPECODES.get(member.type)
    as_array = ros == 2 and member.length is None

    def write(values: Any) -> Any:
        if values is None:  # a null array
            values = ()
        if not is_array(values):
            raise TypeError(f"a {type(values).__name__} is not an array")
        check_length(len(values), member)
        if typecode is None:
            return _each(values, convert, field)
        try:
            packed: array[Any] = array(typecode, values)
        except (TypeError, OverflowError):  # say which element; an integral float is taken
            packed = array(typecode, _each(values, convert, field))
        if typecode == "f" and (math.inf in packed or -math.inf in packed):
            _each(values, convert, field)
        return packed if as_array else packed.tolist()

    return write


def octets_reader(member: Member, ros: Literal[1, 2]) -> Convert:
    """Makes a ByteString of what a ROS has for an array of bytes."""

    def from_bytes(value: Any) -> bytes:
        return bytes(value)

    def from_signed(value: Any) -> bytes:
        return bytes(number & 0xFF for number in value)

    def from_octets(value: Any) -> bytes:
        return b"".join(value)

    if member.type != "byte":
        return from_bytes
    return from_signed if ros == 1 else from_octets


def octets_writer(member: Member, ros: Literal[1, 2]) -> Convert:
    """Makes what a ROS has for an array of bytes of a ByteString, or of an array of Byte."""

    def write(value: Any) -> Any:
        octets = b"" if value is None else value
        if not isinstance(octets, bytes):
            if not is_array(octets):
                raise TypeError(f"a {type(value).__name__} is not a ByteString")
            octets = bytes(octets.tolist() if isinstance(octets, memoryview) else octets)
        check_length(len(octets), member)
        if ros == 1:
            return array("b", octets).tolist() if member.type == "byte" else octets
        if member.type == "byte":
            return [octets[i : i + 1] for i in range(len(octets))]
        return array("B", octets) if member.length is None else list(octets)

    return write
