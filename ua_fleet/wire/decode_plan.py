"""Plans that decode the messages of a known layout, several times faster than the generic codec.

A plan belongs to the constant first bytes of a message: flags, PublisherId, WriterGroupId, DataSetWriterId and the
flags of its one DataSetMessage. For one layout (which header fields, which field types) a function is generated that
unpacks the longest possible runs with one `struct.Struct` each, and compares everything that is constant: versions,
field count, type codes. Whatever is not exactly as expected makes it give up (one of GIVE_UP), and the generic
codec decides. So a plan never refuses a message and never accepts one that the generic codec reads otherwise.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from struct import Struct
from typing import Any, Final, NamedTuple

from ua_fleet.errors import RemoteWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType
from ua_fleet.wire.builtin import FIXED
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.messages import DataSetMessage, NetworkMessage
from ua_fleet.wire.packed import LETTERS, octets, packed_array
from ua_fleet.wire.variant import decode_typed

__all__ = [
    "GIVE_UP",
    "MOST_PLANNED_FIELDS",
    "ArrayUnpackers",
    "DecodePlan",
    "PlanFactory",
    "PlanLayout",
    "compile_layout",
    "make_plan",
    "prefix_length",
]

DecodePlan = Callable[[bytes], NetworkMessage]
"""Decodes a message of its layout, and raises one of GIVE_UP on any other."""

PlanFactory = Callable[..., DecodePlan]

GIVE_UP: Final = (struct.error, KeyError, UnicodeDecodeError, RemoteWireError)
"""What a plan may raise on bytes that are not of its layout."""

MOST_PLANNED_FIELDS: Final = 128
"""Generating the function for more fields takes longer than it is worth."""

MOST_SHARED_LAYOUTS: Final = 256
"""Generated functions that all codecs of a process share."""

LONGEST_PLANNED_ARRAY: Final = 16_384
MOST_ARRAY_UNPACKERS: Final = 64

FEWEST_SLICED: Final = 12
"""Values of one segment from which on slices are quicker than names."""

_PUBLISHER_ID_SIZES: Final = (1, 2, 4, 8)


class PlanLayout(NamedTuple):
    """What the generated function depends on."""

    prefix_length: int
    has_sequence_number: bool
    has_timestamp: bool
    has_status: bool
    has_major_version: bool
    has_minor_version: bool
    types: tuple[int, ...]


def prefix_length(data: bytes) -> int:
    """How many first bytes are constant for a DataSetWriter; 0 where the header is not of a kind that we plan.

    We plan for what publishers of single DataSetMessages send: a numeric PublisherId, at most the WriterGroupId in
    the group header, no security, no ExtendedFlags2; a key frame with Variant fields.
    """
    if len(data) < 4:
        return 0
    flags = data[0]
    position = 1
    publisher_id_type = 0
    if flags & 0x80:
        publisher_id_type = data[1]
        if publisher_id_type > 3:
            return 0
        position = 2
    if flags & 0x10:
        position += _PUBLISHER_ID_SIZES[publisher_id_type]
    try:
        if flags & 0x20:
            if data[position] != 0x01:
                return 0
            position += 3
        if flags & 0x40:
            if data[position] != 1:
                return 0
            position += 3
        flags1 = data[position]
        if flags1 & 0x07 != 0x01:  # valid, Variant encoding
            return 0
        if not flags1 & 0x80:
            return position + 1
        return 0 if data[position + 1] & 0xEF else position + 2  # a key frame with nothing but perhaps a Timestamp
    except IndexError:
        return 0


class ArrayUnpackers(dict[int, Callable[..., tuple[Any, ...]]]):
    """For arrays of one fixed-size type: from the element count to the function that unpacks them, made on demand."""

    def __init__(self, kind: int) -> None:
        super().__init__()
        self._code = FIXED[kind].format[1:]

    def __missing__(self, count: int) -> Callable[..., tuple[Any, ...]]:
        if count > LONGEST_PLANNED_ARRAY:
            raise KeyError(count)
        unpack = Struct(f"<{count}{self._code}").unpack_from
        if len(self) < MOST_ARRAY_UNPACKERS:
            self[count] = unpack
        return unpack


_ARRAYS: Final = {kind: ArrayUnpackers(kind) for kind in FIXED}


@lru_cache(MOST_SHARED_LAYOUTS)
def compile_layout(layout: PlanLayout, *, packed_arrays: bool = False) -> PlanFactory:
    """Generate the function for a layout: it takes what differs between writers and gives a plan.

    A process that has several codecs, or one after the other, generates it once.
    With `packed_arrays` arrays of numbers are views of the message's bytes (see `packed.py`), and ByteStrings too.
    """
    source, names = _Source(layout, packed_arrays=packed_arrays).write()
    code = compile(source, "<decode plan>", "exec")
    exec(code, names)  # noqa: S102 - the source is made of our own words and of type codes
    make: PlanFactory = names["make"]
    return make


def make_plan(make: PlanFactory, layout: PlanLayout, data: bytes, message: NetworkMessage) -> DecodePlan | None:
    """A plan for messages like `message`, which the generic codec decoded from `data`; None if it can have none."""
    part = message.messages[0]
    start = layout.prefix_length + 2 * layout.has_sequence_number + 8 * layout.has_timestamp + 2 * layout.has_status
    size = 4 * layout.has_major_version + 4 * layout.has_minor_version + 3
    plan = make(
        data[start : start + size],
        message.publisher_id,
        message.publisher_id_type,
        message.writer_group_id,
        message.payload_header,
        part.data_set_writer_id,
        part.types,
        part.major_version,
        part.minor_version,
    )
    try:
        plan(data)
    except GIVE_UP:  # padding at its end, for instance
        return None
    return plan


OF_A_PLAN: Final = (
    "expected_constant, publisher_id, publisher_id_type, writer_group_id, payload_header, "
    "data_set_writer_id, types, major_version, minor_version"
)
"""What differs between plans of the same layout."""


class _Source:
    """Writes the function for a layout."""

    def __init__(self, layout: PlanLayout, *, packed_arrays: bool) -> None:
        self._layout, self._packed_arrays = layout, packed_arrays
        self._lines: list[str] = []
        self._names: dict[str, Any] = {
            "new": tuple.__new__,  # pyright: ignore[reportUnknownMemberType]
            "NetworkMessage": NetworkMessage,
            "DataSetMessage": DataSetMessage,
            "Cursor": Cursor,
            "decode_typed": decode_typed,
            "octets": octets,
            "packed_array": packed_array,
        }
        self._format = ""
        self._targets: list[str] = []
        self._values: list[list[str] | str] = []
        """What makes up the tuple of values, in its order: names, and expressions of tuples."""
        self._checked: list[str] = []
        """Conditions on constants, any of which shows that the message is of another layout."""
        self._position = "0"
        self._segments = 0

    def write(self) -> tuple[str, dict[str, Any]]:
        layout = self._layout
        self._format = f"{layout.prefix_length}x"
        for present, code, name in (
            (layout.has_sequence_number, "H", "sequence_number"),
            (layout.has_timestamp, "q", "timestamp"),
            (layout.has_status, "H", "status"),
        ):
            if present:
                self._take(code, name)
        self._take(f"{4 * layout.has_major_version + 4 * layout.has_minor_version + 3}s", "constant")
        for index, type_code in enumerate(layout.types):
            self._field(index, type_code)
        self._end_message()
        status = "status and status << 16" if layout.has_status else "None"
        values = " + ".join(part if isinstance(part, str) else f"({', '.join(part)},)" for part in self._values)
        lines = [
            f"def make({OF_A_PLAN}):",
            # As defaults of arguments they are local variables, the fastest there are.
            f" def decode(data, {', '.join(f'{name}={name}' for name in (*OF_A_PLAN.split(', '), *self._names))}):",
            *(f"  {line}" for line in self._lines),
            "  return new(NetworkMessage, (",
            "   publisher_id, publisher_id_type, None, writer_group_id, None, None, None, None, None, None, None,",
            "   payload_header, (new(DataSetMessage, (",
            f"    data_set_writer_id, 0, types, {values},",
            f"    {'sequence_number' if layout.has_sequence_number else 'None'},",
            f"    {'timestamp' if layout.has_timestamp else 'None'}, None, {status},",
            "    major_version, minor_version, 0, None, None, None, None, None, None, None, True,",
            "   )),),",
            "  ))",
            " return decode",
        ]
        return "\n".join(lines), self._names

    def _take(self, code: str, name: str) -> None:
        self._format += code
        self._targets.append(name)

    def _field(self, index: int, type_code: int) -> None:
        kind = type_code & ~ARRAY
        if index:  # the first type code is a part of the constant
            self._take("B", f"t{index}")
        value = f"v{index}"
        if type_code in FIXED:
            self._take(FIXED[type_code].format[1:], value)
            return
        if type_code in (BuiltinType.STRING, BuiltinType.XML_ELEMENT, BuiltinType.BYTE_STRING):
            self._take("I", "size")  # null, -1, is a size that no datagram has
            start = self._end_segment()
            self._lines.append(f"end{index} = {start} + size")
            if type_code != BuiltinType.BYTE_STRING:
                self._lines.append(f"{value} = data[{start}:end{index}].decode()")
            elif self._packed_arrays:
                self._lines.append(f"{value} = octets(data, {start}, end{index})")
            else:
                self._lines.append(f"{value} = data[{start}:end{index}]")
            self._position = f"end{index}"
        elif type_code & ARRAY and not type_code & DIMENSIONS and kind in FIXED:
            self._take("I", "size")
            start = self._end_segment()
            letter = LETTERS.get(kind) if self._packed_arrays else None
            if letter is None:
                self._names[f"array{kind}"] = _ARRAYS[kind]
                self._lines.append(f"{value} = array{kind}[size](data, {start})")
            else:
                self._lines.append(f"{value} = packed_array(data, {start}, size, {letter!r})")
            self._position = f"{start} + {FIXED[kind].size} * size"
        else:
            start = self._end_segment()
            self._check()
            self._lines += [f"cursor = Cursor(data, {start})", f"{value} = decode_typed(cursor, {type_code})"]
            self._position = "cursor.position"
        self._name_values([value])

    def _name_values(self, names: list[str]) -> None:
        if self._values and isinstance(self._values[-1], list):
            self._values[-1] += names
        elif names:
            self._values.append(names)

    def _unpack(self, method: str) -> int:
        """Write the unpacking of what was collected since the last segment, and return its size."""
        layout = Struct("<" + self._format)
        name = f"unpack{self._segments}"
        self._names[name] = getattr(layout, method)
        arguments = f"data, {self._position}" if self._segments else "data"
        self._assign(f"{name}({arguments})")
        if not self._segments:
            self._checked.insert(0, "constant != expected_constant")
        self._segments += 1
        self._format, self._targets = "", []
        return layout.size

    def _assign(self, unpacked: str) -> None:
        """Write the assignment of a segment: what stands before the fields, then type codes and values by turns.

        Many fields are taken apart and compared by slices: one name for each would cost more than all the rest.
        """
        fields = [target for target in self._targets if target[0] in "tv" and target[1:].isdigit()]
        values = [target for target in fields if target[0] == "v"]
        codes = {target: self._layout.types[int(target[1:])] for target in fields if target[0] == "t"}
        if len(values) < FEWEST_SLICED:
            self._lines.append(f"{', '.join(self._targets)}, = {unpacked}")
            self._checked += [f"{target} != {code}" for target, code in codes.items()]
            self._name_values(values)
            return
        parts = f"parts{self._segments}"
        self._lines.append(f"{parts} = {unpacked}")
        first = self._targets.index(fields[0])
        if first:
            self._lines.append(f"{', '.join(self._targets[:first])}, = {parts}[:{first}]")
        last = ""
        if self._targets[-1] == "size":
            self._lines.append(f"size = {parts}[-1]")
            last = "-1"
        first_code, first_value = (first + 1, first) if fields[0][0] == "v" else (first, first + 1)
        self._checked.append(f"{parts}[{first_code}::2] != {tuple(codes.values())!r}")
        self._values.append(f"{parts}[{first_value}:{last}:2]")

    def _end_segment(self) -> str:
        """What follows has a variable size: unpack up to here, and return where it starts."""
        if self._targets:
            if self._segments and not self._position.isidentifier():
                self._lines.append(f"start = {self._position}")
                self._position = "start"
            size = self._unpack("unpack_from")
            self._position = str(size) if self._position == "0" else f"{self._position} + {size}"
        return self._position

    def _end_message(self) -> None:
        if self._segments:
            self._lines.append(f"if {self._end_segment()} != len(data): raise KeyError")
        else:
            self._unpack("unpack")  # of exactly the size of the message
        self._check()

    def _check(self) -> None:
        """Write the comparison of the constants that were unpacked since the last one."""
        if self._checked:
            self._lines.append(f"if {' or '.join(self._checked)}: raise KeyError")
            self._checked = []
