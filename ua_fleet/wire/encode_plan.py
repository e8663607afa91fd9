"""Plans that encode the key frames of one DataSetWriter, several times faster than the generic codec.

For one list of field types a function is generated that packs the longest possible runs with one `struct.Struct` each.
A value that does not fit makes it give up, and the generic codec encodes the message or says what is wrong with it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from struct import Struct
from typing import Any, Final

from ua_fleet.errors import LocalWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType
from ua_fleet.wire.builtin import FIXED
from ua_fleet.wire.generic import encode_message
from ua_fleet.wire.messages import DataSetMessage, FieldEncoding, FrameKind, NetworkMessage, PublisherIdType
from ua_fleet.wire.packed import LETTERS, is_packed
from ua_fleet.wire.variant import encode_typed

__all__ = ["EncodeFields", "WriterPlan"]

EncodeFields = Callable[[int, int, int, tuple[Any, ...]], bytes]
"""(sequence_number, timestamp, status, values) -> the NetworkMessage."""

MOST_NAMED_FIELDS: Final = 16
"""Beyond it a list of all arguments is faster than a variable for each field."""
MOST_PLANNED_FIELDS: Final = 128
"""Generating the function for more fields takes longer than it is worth."""

_ARRAY_HEAD: Final = Struct("<Bi")
MOST_ARRAY_PACKERS: Final = 64
LONGEST_PLANNED_ARRAY: Final = 16_384


class WriterPlan:
    """Encodes the key frames of one DataSetWriter with one ConfigurationVersion."""

    __slots__ = ("_head", "_message", "_network_message", "_tail", "encode")

    encode: EncodeFields
    """encode(sequence_number, timestamp, status, values) -> bytes; raises LocalWireError on what does not fit.

    An attribute and not a method, since it is the generated function itself.
    """

    def __init__(
        self,
        publisher_id: int,
        writer_group_id: int,
        data_set_writer_id: int,
        types: tuple[int, ...],
        major_version: int,
        minor_version: int,
    ) -> None:
        self._network_message = NetworkMessage(
            publisher_id=publisher_id,
            publisher_id_type=PublisherIdType.UINT16.value,
            writer_group_id=writer_group_id,
        )
        self._message = DataSetMessage(
            data_set_writer_id,
            kind=FrameKind.KEY.value,
            types=types,
            major_version=major_version,
            minor_version=minor_version,
        )
        self._head, self._tail = self._network_message[:12], self._message[8:]
        self.encode = self._encode_generic
        if types and len(types) <= MOST_PLANNED_FIELDS:
            prefix, constant = self._constants()
            self.encode = _function_for(types)(prefix, constant, self._encode_generic)

    @classmethod
    def for_message(cls, message: NetworkMessage, part: DataSetMessage) -> WriterPlan | None:
        """The plan for messages like this one, which has the one DataSetMessage `part`; None where there is none."""
        if (
            message.publisher_id_type != PublisherIdType.UINT16
            or not isinstance(message.publisher_id, int)
            or message.writer_group_id is None
            or part.kind != FrameKind.KEY
            or part.encoding != FieldEncoding.VARIANT
            or part.major_version is None
            or part.minor_version is None
        ):
            return None
        plan = cls(
            message.publisher_id,
            message.writer_group_id,
            part.data_set_writer_id,
            part.types,
            part.major_version,
            part.minor_version,
        )
        return plan if plan.fits(message, part) else None

    def fits(self, message: NetworkMessage, part: DataSetMessage) -> bool:
        """Whether `encode` makes of the variable parts of a message, with its one DataSetMessage, all of its bytes."""
        return (
            message[:12] == self._head
            and part[8:] == self._tail
            and part[0] == self._message[0]
            and part[2] == self._message[2]
            and part[1] == 0
            and part[4] is not None
            and part[5] is not None
            and part[6] is None
            and part[7] is not None
        )

    def encode_like(self, part: DataSetMessage) -> bytes:
        """Encode a DataSetMessage of a NetworkMessage that fits."""
        # `fits` made sure that none of them is None.
        return self.encode(part[4], part[5], part[7], part[3])  # type: ignore[arg-type] # pyright: ignore[reportArgumentType]

    def _encode_generic(self, sequence_number: int, timestamp: int, status: int, values: tuple[Any, ...]) -> bytes:
        part = self._message._replace(
            values=values, sequence_number=sequence_number, timestamp=timestamp, status=status
        )
        if part.sequence_number is None or part.timestamp is None or part.status is None:  # it would leave them out
            raise LocalWireError("a key frame needs its sequence number, timestamp and status")
        return encode_message(self._network_message._replace(messages=(part,)))

    def _constants(self) -> tuple[bytes, bytes]:
        """The bytes before the sequence number; those from the major version up to the first type code."""
        header = self._message._replace(types=(), sequence_number=0, timestamp=0, status=0)
        frame = encode_message(self._network_message._replace(messages=(header,)))
        count = len(self._message.types).to_bytes(2, "little")
        return frame[:-20], frame[-8:] + count + self._message.types[0].to_bytes(1, "little")


class ArrayPackers(dict[int, Callable[..., bytes]]):
    """For arrays of one fixed-size type: from the element count to the function that packs all of the Variant."""

    def __init__(self, kind: int) -> None:
        super().__init__()
        self._code = FIXED[kind].format[1:]
        self._letter = LETTERS.get(kind)

    def encode(self, code: int, value: Any) -> bytes:
        """The Variant of an array; raises one of GIVE_UP for what is none."""
        if value.__class__ is tuple:
            return self[len(value)](code, len(value), *value)
        if is_packed(value, self._letter):
            return b"".join((_ARRAY_HEAD.pack(code, len(value)), value))
        raise TypeError

    def __missing__(self, count: int) -> Callable[..., bytes]:
        if count > LONGEST_PLANNED_ARRAY:
            raise KeyError(count)
        pack = Struct(f"<Bi{count}{self._code}").pack
        if len(self) < MOST_ARRAY_PACKERS:
            self[count] = pack
        return pack


_ARRAYS: Final = {kind: ArrayPackers(kind) for kind in FIXED}


@lru_cache(maxsize=256)
def _function_for(types: tuple[int, ...]) -> Callable[..., EncodeFields]:
    names: dict[str, Any] = {
        "GIVE_UP": (struct.error, KeyError, TypeError, ValueError, AttributeError, OverflowError, LocalWireError),
        "encode_typed": encode_typed,
        "is_packed": is_packed,
        "join": b"".join,
    }
    if len(types) > MOST_NAMED_FIELDS and all(code in FIXED for code in types):
        body = _write_list(types, names)
    else:
        body = _write_segments(types, names)
    lines = [
        "def make(prefix, constant, encode_generic):",
        " def encode(sequence_number, timestamp, status, values):",
        "  try:",
        *(f"   {line}" for line in body),
        "  except GIVE_UP:",
        "   return encode_generic(sequence_number, timestamp, status, values)",
        " return encode",
    ]
    code = compile("\n".join(lines), "<encode plan>", "exec")
    exec(code, names)  # noqa: S102 - the source is made of our own words and of type codes
    make: Callable[..., EncodeFields] = names["make"]
    return make


HEADER: Final = "12sHqH11s"
"""Prefix, sequence number, timestamp, status; versions, field count and the first type code."""
HEADER_ARGUMENTS: Final = "prefix, sequence_number, timestamp, status >> 16, constant"


def _write_list(types: tuple[int, ...], names: dict[str, Any]) -> list[str]:
    """Fixed-size fields only: all arguments in one list, values in every other place of it."""
    names["pack"] = Struct("<" + HEADER + "B".join(FIXED[code].format[1:] for code in types)).pack
    arguments: list[Any] = [0]
    for code in types[1:]:
        arguments += (code, 0)
    names["arguments"] = arguments
    body: list[str] = []
    for index, code in enumerate(types):
        if code == BuiltinType.BOOLEAN:
            body.append(f"if values[{index}].__class__ is not bool: raise TypeError")
    return [
        *body,
        f"fields = [{HEADER_ARGUMENTS}, *arguments]",
        "fields[5::2] = values",
        "return pack(*fields)",
    ]


def _write_segments(types: tuple[int, ...], names: dict[str, Any]) -> list[str]:
    """Runs of fixed-size fields as one pack each, and between them what has a variable size."""
    lines = ["".join(f"v{index}, " for index in range(len(types))) + "= values"]
    parts: list[str] = []
    layout, arguments = HEADER, HEADER_ARGUMENTS

    def end_segment() -> None:
        nonlocal layout, arguments
        if layout:
            name = f"pack{len(parts)}"
            names[name] = Struct("<" + layout).pack
            parts.append(f"{name}({arguments.removeprefix(', ')})")
        layout, arguments = "", ""

    for index, code in enumerate(types):
        value = f"v{index}"
        # The type code of the first field stands at the end of the header.
        type_code = ("B", f", {code}") if index else ("", "")
        if code in FIXED:
            if code == BuiltinType.BOOLEAN:
                lines.append(f"if {value}.__class__ is not bool: raise TypeError")
            layout += type_code[0] + FIXED[code].format[1:]
            arguments += f"{type_code[1]}, {value}"
        elif code in (BuiltinType.STRING, BuiltinType.XML_ELEMENT, BuiltinType.BYTE_STRING):
            if code == BuiltinType.BYTE_STRING:
                lines.append(f"if {value}.__class__ is not bytes and not is_packed({value}, 'B'): raise TypeError")
            else:
                lines.append(f"{value} = {value}.encode()")
            layout += type_code[0] + "i"
            arguments += f"{type_code[1]}, len({value})"
            end_segment()
            parts.append(value)
        elif index and _is_planned_array(code):
            end_segment()
            kind = code & ~ARRAY
            names[f"array{kind}"] = _ARRAYS[kind].encode
            parts.append(f"array{kind}({code}, {value})")
        else:
            lines += [f"x{index} = bytearray()", f"encode_typed(x{index}, {code}, {value})"]
            end_segment()
            parts.append(f"x{index}" if index else "x0[1:]")
    end_segment()
    return [*lines, f"return {parts[0]}" if len(parts) == 1 else f"return join(({', '.join(parts)}))"]


def _is_planned_array(code: int) -> bool:
    return (
        bool(code & ARRAY) and not code & DIMENSIONS and code & ~ARRAY in FIXED and code != ARRAY | BuiltinType.BOOLEAN
    )
