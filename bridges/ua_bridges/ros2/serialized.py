# pyright: basic, reportMissingImports=false
"""Messages of ROS 2 as they come from the middleware, in CDR: what is read of them without making an object each."""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from struct import error as StructError  # noqa: N812 - its name says nothing
from typing import Any, Final

from ua_bridges.ros.codec import CDR_LITTLE_ENDIAN, Decoder, compile_decoder
from ua_bridges.ros.convert import compile_reader
from ua_bridges.ros.errors import Unreadable
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.elements import Elements

__all__ = ["flat_reader", "message_reader", "stamp_reader"]

_PLAIN: Final = CDR_LITTLE_ENDIAN[:2]
_STAMP: Final = Struct("<iI")


def message_reader(kind: MessageType) -> Callable[[bytes], Any]:
    """A function that makes a message object; it raises Unreadable."""
    elements = Elements(kind.schema)

    def read(content: bytes) -> Any:
        from rclpy.serialization import deserialize_message

        elements.check(content)
        try:
            return deserialize_message(content, kind.cls)
        except (RuntimeError, MemoryError, ValueError) as error:  # rclpy's RMWError is a RuntimeError
            raise Unreadable(kind.name, " ".join(str(error).split())) from error

    return read


def flat_reader(kind: MessageType, wanted: frozenset[str] | None = None) -> Decoder:
    """A function from a message's bytes to the values of its flat fields; it raises ConversionError.

    Args:
        kind: the type of the messages.
        wanted: the flat fields that are needed, all without; long arrays of others may be None.
    """
    decode, values = compile_decoder(kind.schema, wanted, packed_arrays=True), compile_reader(kind.schema)
    message = message_reader(kind)

    def read(content: bytes) -> tuple[Any, ...]:
        if decode is None or content[:2] != _PLAIN:
            return values(message(content))
        return decode(content)

    return read


def stamp_reader(kind: MessageType) -> Callable[[bytes], int] | None:
    """A function that reads the stamp of a message's Header, in ns since 1970; None for a type without one."""
    if not kind.has_header:
        return None
    message = message_reader(kind)
    is_first = kind.schema.members[0].name == "header"

    def read(content: bytes) -> int:
        if is_first and content[:2] == _PLAIN:
            try:
                seconds, nanoseconds = _STAMP.unpack_from(content, len(CDR_LITTLE_ENDIAN))
            except StructError as error:
                raise Unreadable(kind.name, str(error)) from error
        else:
            stamp = message(content).header.stamp
            seconds, nanoseconds = stamp.sec, stamp.nanosec
        return int(seconds * 1_000_000_000 + nanoseconds)

    return read
