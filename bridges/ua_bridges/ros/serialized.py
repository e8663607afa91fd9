"""Messages as they come from either ROS: what is read of them without making an object each."""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct
from struct import error as StructError  # noqa: N812 - its name says nothing
from typing import Any, Final, Protocol

from ua_bridges.ros.codec import CDR_LITTLE_ENDIAN, Decoder, compile_decoder
from ua_bridges.ros.convert import compile_reader
from ua_bridges.ros.errors import Unreadable
from ua_bridges.ros.schema import MessageSchema

__all__ = ["MessageKind", "flat_reader", "stamp_reader"]

_PLAIN: Final = {1: b"", 2: CDR_LITTLE_ENDIAN[:2]}
"""How content begins that is decoded without the library, by the version of ROS."""
_STAMP: Final = {1: Struct("<4xII"), 2: Struct("<4xiI")}
"""The stamp of a Header at the beginning: behind its `seq` in ROS 1, behind the representation of CDR in ROS 2."""
_PARTS: Final = {1: ("secs", "nsecs"), 2: ("sec", "nanosec")}


class MessageKind(Protocol):
    """A message type of this process, of either ROS."""

    @property
    def name(self) -> str:
        """`pkg/Name`, as this ROS has it."""
        ...

    @property
    def schema(self) -> MessageSchema:
        """Its members; raises SchemaInvalid."""
        ...

    @property
    def definition(self) -> str | None:
        """The full text of its definition in ROS 1."""
        ...

    @property
    def header(self) -> str | None:
        """Name of the member at its top level that is its Header."""
        ...

    def message_reader(self) -> Callable[[bytes], Any]:
        """A function that makes a message object; it raises Unreadable, or what genpy raises."""
        ...


def flat_reader(kind: MessageKind, wanted: frozenset[str] | None = None) -> Decoder:
    """A function from a message's bytes to the values of its flat fields; it raises ConversionError.

    Args:
        kind: the type of the messages.
        wanted: the flat fields that are needed, all without; long arrays of others may be None.
    """
    schema = kind.schema
    decode, values = compile_decoder(schema, wanted, packed_arrays=True), compile_reader(schema)
    message, plain = kind.message_reader(), _PLAIN[schema.ros]
    if decode is None:
        return lambda content: values(message(content))
    if not plain:
        return decode

    def read(content: bytes) -> tuple[Any, ...]:
        return decode(content) if content[:2] == plain else values(message(content))

    return read


def stamp_reader(kind: MessageKind) -> Callable[[bytes], int] | None:
    """A function that reads the stamp of a message's Header, in ns since 1970; None for a type without one."""
    header = kind.header
    if header is None:
        return None
    schema, message = kind.schema, kind.message_reader()
    plain, stamp, (seconds_name, nanoseconds_name) = _PLAIN[schema.ros], _STAMP[schema.ros], _PARTS[schema.ros]
    is_first = schema.members[0].name == header

    def read(content: bytes) -> int:
        if is_first and content[: len(plain)] == plain:
            try:
                seconds, nanoseconds = stamp.unpack_from(content)
            except StructError as error:
                raise Unreadable(kind.name, str(error)) from error
        else:
            found = getattr(message(content), header).stamp
            seconds, nanoseconds = getattr(found, seconds_name), getattr(found, nanoseconds_name)
        return int(seconds * 1_000_000_000 + nanoseconds)

    return read
