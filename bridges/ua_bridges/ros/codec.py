"""Serialized messages of both ROS read into flat fields and made of them, without a message object between.

ROS 2 has CDR (the plain, little-endian encoding of DDS-XTypes 1.3 7.4.1: each value stands at a multiple of its size,
counted from behind the four bytes of the encapsulation), ROS 1 the same without alignment and without the NUL behind a
string. A type becomes a row of steps: neighbours of fixed size are one `Struct` (in CDR one for each place that it may
begin at), whatever has a length of its own is a step of its own. rclpy takes 18 us to read an Imu and 40 us to fill and
write one; here it is 2 us each.

Counts come from the network: none is believed before that many bytes are there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from struct import Struct, pack, unpack_from
from struct import error as StructError  # noqa: N812 - its name says nothing
from typing import Any, Final, NamedTuple, cast

from ua_bridges.ros.errors import ConversionError, Unreadable
from ua_bridges.ros.exact import exact_floats
from ua_bridges.ros.leaves import OCTETS, Form, Leaf, leaves_of
from ua_bridges.ros.scalars import Convert, check_length, integer, is_array, scalar_writer
from ua_bridges.ros.schema import Member, MessageSchema
from ua_fleet.wire.packed import SIZES, is_packed, octets, packed_array

__all__ = ["CDR_LITTLE_ENDIAN", "Decoder", "Encoder", "compile_decoder", "compile_encoder"]

Decoder = Callable[[bytes], tuple[Any, ...]]
"""The values of the flat fields, in the order of `fields_of`; raises ConversionError."""
Encoder = Callable[[Sequence[Any]], bytes]
"""A serialized message of values; raises ConversionError, which names the field."""

CDR_LITTLE_ENDIAN: Final = b"\x00\x01\x00\x00"
"""The encapsulation of plain CDR, little-endian (DDSI-RTPS 10.5); other ones are left to ROS itself."""

_CODES: Final = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_SIZES: Final = {code: Struct(f"<{code}").size for code in "?bBhHiIqQfd"}
_TYPES: Final = {code: float if code in "fd" else bool if code == "?" else int for code in _SIZES}
_COUNT: Final = Struct("<I")
MOST_OBJECTS: Final = 250_000
"""Messages, or texts, in one array: each takes some hundred bytes of memory, and may take one of the message."""
_FAILURES: Final = (TypeError, ValueError, OverflowError, StructError)

_Read = Callable[[bytes, int, list[Any]], int]
"""Appends values that begin at an offset; gives the offset behind them."""
_Write = Callable[[Sequence[Any], list[bytes | memoryview], int], int]
"""Appends bytes that begin at an offset; gives the offset behind them."""


class _Part(NamedTuple):
    """One member of fixed size, or one that is left out of the flat fields (`member` is None)."""

    code: str
    member: Member | None
    length: int | None = None
    """Of a fixed array."""

    @property
    def size(self) -> int:
        """In bytes, without alignment."""
        return _SIZES[self.code] * (1 if self.length is None else self.length)


class _Step(NamedTuple):
    """What is read and written in one go: so many values."""

    read: _Read
    write: _Write
    width: int
    least: int
    """The fewest bytes that it takes."""


def _aligned(offset: int, size: int, *, cdr: bool) -> int:
    return ((offset + size - 5) & -size) + 4 if cdr and size > 1 else offset


def _structs(parts: Sequence[_Part], *, cdr: bool) -> tuple[Struct, ...]:
    """One for each place modulo 8 at which the parts may begin; always the same in ROS 1."""
    made: list[Struct] = []
    for start in range(8):
        layout, position = "<", start
        for code, _, count in parts:
            pad = -position % _SIZES[code] if cdr else 0
            layout += "x" * pad
            layout += code if count is None else f"{count}{'s' if _is_octets(code, count) else code}"
            position += pad + _SIZES[code] * (1 if count is None else count)
        made.append(Struct(layout))
    return tuple(made)


def _is_octets(code: str, count: int | None) -> bool:
    return code == "B" and count is not None


class _Steps:
    """Makes the steps of one type."""

    def __init__(self, ros: int, wanted: frozenset[str] | None, *, packed_arrays: bool = False) -> None:
        """`wanted` are the flat fields that are to be read; arrays of others are passed over, and None stands there."""
        self._ros, self._cdr, self._wanted, self._packed_arrays = ros, ros == 2, wanted, packed_arrays
        self.limits: list[tuple[int, Convert, bool]] = []
        """Values that are to be checked when all are read: where, how, and whether it is an array of them."""

    def of(self, leaves: Sequence[Leaf], schema: MessageSchema) -> list[_Step]:
        """The steps of a type with these leaves."""
        self._names = iter(leaves)
        return list(self._merged(self._parts_of(schema)))

    def _parts_of(self, schema: MessageSchema) -> Iterator[_Part | _Step]:
        for index, member in enumerate(schema.members):
            if index == schema.seq_at:
                yield _Part("I", None)
            yield from self._member(member)
        if schema.seq_at == len(schema.members):
            yield _Part("I", None)
        if not schema.members and self._cdr:
            yield _Part("B", None)  # a structure of C has at least one member

    def _member(self, member: Member) -> Iterator[_Part | _Step]:
        if member.nested is not None:
            if member.array:
                yield self._columns(member, member.nested)
            else:
                yield from self._parts_of(member.nested)
            return
        leaf = next(self._names)
        code = _CODES.get(member.type)
        if code is None:
            yield self._texts(member, leaf) if member.array else self._text(member)
        elif not member.array:
            yield _Part(code, member)
        elif member.length is not None:
            yield _Part(code, member, member.length)
        else:
            yield self._octets(member, leaf) if member.type in OCTETS else self._sequence(code, member, leaf)

    def _merged(self, items: Iterator[_Part | _Step]) -> Iterator[_Step]:
        """Neighbours of fixed size as one step each."""
        parts: list[_Part] = []
        for item in items:
            if isinstance(item, _Part):
                parts.append(item)
                continue
            if parts:
                yield self._run(parts)
                parts = []
            yield item
        if parts:
            yield self._run(parts)

    def _is_wanted(self, leaf: Leaf) -> bool:
        return self._wanted is None or leaf.name in self._wanted

    def _run(self, parts: Sequence[_Part]) -> _Step:
        structs = _structs(parts, cdr=self._cdr)
        read = _run_reader(parts, structs)
        shown = [part for part in parts if part.member is not None]
        return _Step(read, _run_writer(parts, structs, self._ros), len(shown), sum(part.size for part in parts))

    def _text(self, member: Member) -> _Step:
        cdr, check = self._cdr, scalar_writer(member, 2 if self._cdr else 1)

        def read(content: bytes, at: int, out: list[Any]) -> int:
            if cdr:
                at = (at + 3) & -4
            size: int = _COUNT.unpack_from(content, at)[0]
            end = at + 4 + size
            if end > len(content):
                raise ValueError("it ends in the midst of a string")
            out.append(str(content[at + 4 : end - 1 if cdr and size else end], "utf-8", "replace"))
            return end

        def write(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
            data = check(values[0]).encode()
            if cdr:
                pad = -at & 3
                out.append(b"%b%b%b\0" % (b"\0" * pad, _COUNT.pack(len(data) + 1), data))
                return at + pad + 5 + len(data)
            out.append(_COUNT.pack(len(data)) + data)
            return at + 4 + len(data)

        return _Step(read, write, 1, 4)

    def _begin(self, content: bytes, at: int, member: Member, least: int) -> tuple[int, int]:
        """How many elements an array has, and where they begin."""
        if member.length is not None:
            count = member.length
        else:
            at = _aligned(at, 4, cdr=self._cdr)
            count = _COUNT.unpack_from(content, at)[0]
            at += 4
        if count * least > len(content) - at:
            raise ValueError(f"it has not the {count} elements that it announces")
        return count, at

    def _end(self, out: list[bytes | memoryview], at: int, member: Member, count: int) -> int:
        """Write the number of elements, where it is written; where they begin."""
        check_length(count, member)
        if member.length is not None:
            return at
        start = _aligned(at, 4, cdr=self._cdr)
        out.append(b"\0" * (start - at) + _COUNT.pack(count))
        return start + 4

    def _octets(self, member: Member, leaf: Leaf) -> _Step:
        is_wanted, is_viewed = self._is_wanted(leaf), self._packed_arrays

        def read(content: bytes, at: int, out: list[Any]) -> int:
            count, at = self._begin(content, at, member, 1)
            if not is_wanted:
                out.append(None)
            else:
                out.append(octets(content, at, at + count) if is_viewed else content[at : at + count])
            return at + count

        def write(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
            data = _octets_of(values[0])
            at = self._end(out, at, member, len(data))
            out.append(data)
            return at + len(data)

        return _Step(read, write, 1, 4)

    def _sequence(self, code: str, member: Member, leaf: Leaf) -> _Step:
        size, cdr, is_wanted = _SIZES[code], self._cdr, self._is_wanted(leaf)
        is_viewed = self._packed_arrays and code in SIZES
        convert = _converter(member, self._ros)

        def read(content: bytes, at: int, out: list[Any]) -> int:
            count, at = self._begin(content, at, member, size)
            if count:
                at = _aligned(at, size, cdr=cdr)
            if not is_wanted:
                out.append(None)
            elif is_viewed:
                out.append(packed_array(content, at, count, code))
            else:
                out.append(unpack_from(f"<{count}{code}", content, at))
            return at + count * size

        def write(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
            elements = _elements_of(values[0], code)
            at = self._end(out, at, member, len(elements))
            start = _aligned(at, size, cdr=cdr) if elements else at
            if is_packed(elements, code):
                out += (b"\0" * (start - at), cast("memoryview", elements))
                return start + size * len(elements)
            layout = f"<{start - at}x{len(elements)}{code}"
            try:
                out.append(pack(layout, *elements))
            except StructError:  # a float without a fraction is an integer
                out.append(pack(layout, *map(convert, elements)))
            return start + size * len(elements)

        return _Step(read, write, 1, 4)

    def _texts(self, member: Member, leaf: Leaf) -> _Step:
        one, is_wanted = self._text(member), self._is_wanted(leaf)

        def read(content: bytes, at: int, out: list[Any]) -> int:
            count, at = self._begin(content, at, member, 4)
            _check_objects(count)
            texts: list[Any] = []
            for _ in range(count):
                at = one.read(content, at, texts)
            out.append(tuple(texts) if is_wanted else None)
            return at

        def write(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
            texts = _elements_of(values[0], "s")
            at = self._end(out, at, member, len(texts))
            for text in texts:
                at = one.write((text,), out, at)
            return at

        return _Step(read, write, 1, 4 * (member.length or 1))

    def _columns(self, member: Member, nested: MessageSchema) -> _Step:
        """An array of messages, one array for each of their scalars."""
        steps = list(self._merged(self._parts_of(nested)))
        width, least = sum(step.width for step in steps), sum(step.least for step in steps)

        def read(content: bytes, at: int, out: list[Any]) -> int:
            count, at = self._begin(content, at, member, least)
            _check_objects(count)
            rows: list[list[Any]] = []
            for _ in range(count):
                row: list[Any] = []
                for step in steps:
                    at = step.read(content, at, row)
                rows.append(row)
            out.extend(zip(*rows, strict=True) if rows else [()] * width)
            return at

        def write(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
            columns = [_elements_of(value, "s") for value in values]
            at = self._end(out, at, member, len(columns[0]))
            for row in zip(*columns, strict=True):
                at = _write_all(steps, row, out, at)
            return at

        return _Step(read, write, width, 4 if member.length is None else least * member.length)


def _write_all(steps: Sequence[_Step], values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
    done = 0
    for step in steps:
        at = step.write(values[done : done + step.width], out, at)
        done += step.width
    return at


def _check_objects(count: int) -> None:
    if count > MOST_OBJECTS:
        raise ValueError(f"an array of {count} elements, at most {MOST_OBJECTS} are read")


def _octets_of(value: Any) -> bytes | memoryview:
    if type(value) is bytes or is_packed(value, "B"):
        return cast("bytes | memoryview", value)
    if isinstance(value, memoryview):  # of other numbers, whose bytes are something else
        value = value.tolist()
    if value is not None and not is_array(value):
        raise TypeError(f"a {type(value).__name__} is not a ByteString")
    return bytes(value or b"")


def _elements_of(value: Any, code: str) -> Sequence[Any]:
    if value is None:  # a null array
        return ()
    if not is_array(value):
        raise TypeError(f"a {type(value).__name__} is not an array")
    if code == "?" and not set(map(type, value)) <= {bool}:  # whatever is true would be packed
        raise TypeError("not all elements are bools")
    return value


def _run_reader(parts: Sequence[_Part], structs: Sequence[Struct]) -> _Read:
    slices: list[tuple[int, int | None]] = []
    place = 0
    for code, member, count in parts:
        width = 1 if count is None or _is_octets(code, count) else count
        if member is not None:
            slices.append((place, None if count is None or _is_octets(code, count) else place + width))
        place += width

    if place == len(slices) and all(stop is None for _, stop in slices):

        def read_scalars(content: bytes, at: int, out: list[Any]) -> int:
            struct = structs[(at - 4) & 7]
            out += struct.unpack_from(content, at)
            return at + struct.size

        return read_scalars

    def read(content: bytes, at: int, out: list[Any]) -> int:
        struct = structs[(at - 4) & 7]
        found = struct.unpack_from(content, at)
        for start, stop in slices:
            out.append(found[start] if stop is None else found[start:stop])
        return at + struct.size

    return read


def _run_writer(parts: Sequence[_Part], structs: Sequence[Struct], ros: int) -> _Write:
    expected = tuple(_TYPES[part.code] for part in parts)
    if all(part.member is not None and part.length is None for part in parts):
        members = [part.member for part in parts if part.member is not None]
        converts = [_converter(member, ros) for member in members]
        must = [(index, convert) for index, convert in enumerate(converts) if members[index].limits is not None]

        def write_scalars(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
            if tuple(map(type, values)) != expected:
                values = [convert(value) for convert, value in zip(converts, values, strict=True)]
            for index, convert in must:
                convert(values[index])
            struct = structs[(at - 4) & 7]
            out.append(struct.pack(*values))
            return at + struct.size

        return write_scalars

    each = [None if part.member is None else _converter(part.member, ros) for part in parts]
    are_floats = all(part.member is not None and part.code in "fd" for part in parts)
    gather = exact_floats([part.length for part in parts]) if are_floats else None

    def write(values: Sequence[Any], out: list[bytes | memoryview], at: int) -> int:
        if gather is not None and (exact := gather(values)) is not None:
            struct = structs[(at - 4) & 7]
            out.append(struct.pack(*exact))
            return at + struct.size
        packed: list[Any] = []
        rest = iter(values)
        for (code, member, count), type_, convert in zip(parts, expected, each, strict=True):
            if member is None or convert is None:
                packed.append(0)
            elif count is None:
                value = next(rest)
                is_exact = type(value) is type_ and member.limits is None
                packed.append(value if is_exact else convert(value))
            elif _is_octets(code, count):
                data = _octets_of(next(rest))
                check_length(len(data), member)
                packed.append(data)
            else:
                elements = _elements_of(next(rest), code)
                check_length(len(elements), member)
                is_exact = type_ is not int or float not in set(map(type, elements))
                packed += elements if is_exact else map(convert, elements)
        struct = structs[(at - 4) & 7]
        out.append(struct.pack(*packed))
        return at + struct.size

    return write


def _converter(member: Member, ros: int) -> Convert:
    """Checks a value for a member, or for an element of it, and makes of it what a Struct packs."""
    return integer(0, 255) if member.type == "byte" else scalar_writer(member, 2 if ros == 2 else 1)


def _has_codec(schema: MessageSchema, leaves: Sequence[Leaf]) -> bool:
    return all(leaf.form is not Form.RAGGED and leaf.member.type != "wstring" for leaf in leaves)


def compile_decoder(
    schema: MessageSchema, wanted: frozenset[str] | None = None, *, packed_arrays: bool = False
) -> Decoder | None:
    """A function that reads serialized messages; None for types that only ROS itself can read.

    Those are types with wide strings, or with messages in arrays that have arrays again.

    Args:
        schema: the type of the messages.
        wanted: names of the flat fields that are needed, all without: long arrays of others are None in the result.
        packed_arrays: whether long arrays of numbers and of bytes may be views of the message.
    """
    leaves = leaves_of(schema)
    if not _has_codec(schema, leaves):
        return None
    steps = _Steps(schema.ros, wanted, packed_arrays=packed_arrays).of(leaves, schema)
    limits = [
        (index, leaf.name, integer(*leaf.member.limits), leaf.is_array)
        for index, leaf in enumerate(leaves)
        if leaf.member.limits is not None
    ]
    start = len(CDR_LITTLE_ENDIAN) if schema.ros == 2 else 0

    def decode(content: bytes) -> tuple[Any, ...]:
        values: list[Any] = []
        at = start
        try:
            for step in steps:
                at = step.read(content, at, values)
        except _FAILURES as error:
            raise Unreadable(schema.name, str(error)) from error
        for index, name, check, is_column in limits:
            try:
                if is_column:
                    for value in values[index]:
                        check(value)
                else:
                    check(values[index])
            except _FAILURES as error:
                raise ConversionError(name, str(error)) from error
        return tuple(values) if leaves else (True,)

    return decode


def compile_encoder(
    schema: MessageSchema, names: Sequence[str], explain: Callable[[Sequence[Any]], object]
) -> Encoder | None:
    """A function that makes serialized messages of values; None for types that only ROS itself can write.

    Args:
        schema: the type of the messages.
        names: the flat field of each value, in their order: all that the type has, and no other.
        explain: raises the ConversionError that names the field which does not fit; asked when something does not.
    """
    leaves = leaves_of(schema)
    if not _has_codec(schema, leaves):
        return None
    steps = _Steps(schema.ros, None).of(leaves, schema)
    order = [names.index(leaf.name) for leaf in leaves]
    in_order = order == list(range(len(names)))
    head = CDR_LITTLE_ENDIAN if schema.ros == 2 else b""
    count = len(names)

    def encode(values: Sequence[Any]) -> bytes:
        if len(values) != count:
            raise ConversionError("*", f"{len(values)} values for {count} fields")
        parts: list[bytes | memoryview] = [head]
        try:
            _write_all(steps, values if in_order else [values[index] for index in order], parts, len(head))
        except _FAILURES as error:
            explain(values)
            raise ConversionError("*", str(error)) from error
        return b"".join(parts)

    return encode
