"""What a request's bytes announce, walked by strict code before asyncua builds anything of it (docs/adr/0030).

A walk reads lengths, counts and types alone, and makes no object. It refuses what the bytes cannot hold, what would
take more memory than its budget, what is nested too deep, and what OPC 10000-6 5.2 does not allow. Its steps are
compiled from the dataclasses that asyncua's decoder is made of, so that both read the same structure.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import dataclasses
import functools
import struct
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum, IntFlag
from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import get_safe_type_hints, nodeid_from_binary, resolve_uatype
from asyncua.ua.uatypes import (
    type_allow_subclass,
    type_from_list,
    type_from_optional,
    type_is_list,
    type_is_optional,
    type_is_union,
    types_or_list_from_union,
)

from ua_fleet.endpoint.data_values import misplaced
from ua_fleet.endpoint.stack import Refusal, StatusCodes

__all__ = ["DEEPEST_NESTING", "Scan", "TypeStep", "step_of", "steps_of"]

DEEPEST_NESTING: Final = 100
"""Levels of nested values; OPC 10000-6 5.1.5 wants decoders to take as many."""

_INT32: Final = struct.Struct("<i")
_OBJECT: Final = 160
"""Bytes of memory that a structure takes beyond its fields."""
_TEXT: Final = 96
"""Bytes of memory that a String or ByteString takes beyond its content."""
_MOST_DIMENSIONS: Final = 32


class Scan:
    """A walk through one message, and what is left of its budget."""

    __slots__ = ("data", "depth", "end", "memory", "misplaced", "position", "share")

    def __init__(self, data: bytes, position: int, end: int, memory: int) -> None:
        self.data, self.position, self.end = data, position, end
        self.memory = memory
        """Bytes of memory that decoded values may still take."""
        self.share = memory
        """As `memory`, of structures and texts in one operation: they take their time to be built."""
        self.depth = 0
        self.misplaced: list[int] = []
        """Where the times of DataValues are in another order than asyncua reads them."""

    def refuse(self, what: str) -> Refusal:
        """The error for bytes that are no valid encoding."""
        return Refusal(StatusCodes.BadDecodingError, f"{what} at byte {self.position}")

    def skip(self, size: int) -> None:
        """Pass bytes."""
        self.position += size
        if self.position > self.end:
            raise self.refuse("the message ends")

    def byte(self) -> int:
        """A Byte."""
        self.skip(1)
        return self.data[self.position - 1]

    def int32(self) -> int:
        """An Int32."""
        self.skip(4)
        value: int = _INT32.unpack_from(self.data, self.position - 4)[0]
        return value

    def count(self, least: int) -> int:
        """A count of elements of at least `least` bytes each, 0 for null; held against the bytes that are left."""
        count = self.int32()
        if count < -1:
            raise self.refuse(f"length {count}")
        if count * least > self.end - self.position:
            raise self.refuse(f"{count} elements announced, {self.end - self.position} bytes left")
        return max(count, 0)

    def charge(self, memory: int) -> None:
        """Take memory for numbers from the budget."""
        self.memory -= memory
        if self.memory < 0:
            raise Refusal(StatusCodes.BadEncodingLimitsExceeded, "a request that takes too much memory when decoded")

    def charge_built(self, memory: int) -> None:
        """Take memory for structures and texts from the budget."""
        self.charge(memory)
        self.share -= memory
        if self.share < 0:
            raise Refusal(StatusCodes.BadEncodingLimitsExceeded, "an operation that takes too long to be decoded")

    def descend(self) -> None:
        """Enter a nested value; `depth` is lowered when it is left."""
        self.depth += 1
        if self.depth > DEEPEST_NESTING:
            raise Refusal(StatusCodes.BadEncodingLimitsExceeded, f"more than {DEEPEST_NESTING} levels")


@dataclass(frozen=True, slots=True)
class TypeStep:
    """How one type is walked."""

    walk: Callable[[Scan], None]
    least: int
    """Smallest number of bytes that a value has."""
    memory: int
    """Bytes of memory that a value takes, without what it holds by counts."""
    size: int | None = None
    """Number of bytes, where all values have the same."""
    number: bool = False
    """Whether arrays of it are decoded in one go."""


def _fixed(size: int, memory: int = 48, *, number: bool = False) -> TypeStep:
    def walk(scan: Scan) -> None:
        scan.position += size
        if scan.position > scan.end:
            raise scan.refuse("the message ends")

    return TypeStep(walk, size, memory, size, number)


def _walk_text(scan: Scan) -> None:
    position = scan.position + 4
    if position > scan.end:
        raise scan.refuse("the message ends")
    length = _INT32.unpack_from(scan.data, scan.position)[0]
    if length > 0:
        position += length
        if position > scan.end:
            raise scan.refuse(f"a text of {length} bytes")
    elif length < -1:
        raise scan.refuse(f"length {length}")
    scan.position = position


def _walk_string(scan: Scan) -> None:
    """UTF-8 (OPC 10000-6 5.2.2.4): asyncua lets other bytes pass, as characters that nothing can encode again."""
    start = scan.position + 4
    _walk_text(scan)
    if start < scan.position:
        try:
            scan.data[start : scan.position].decode()
        except UnicodeDecodeError as error:
            raise scan.refuse("a String that is no UTF-8") from error


def _walk_node_id(scan: Scan) -> None:
    encoding = scan.byte()
    kind = encoding & 0x3F
    if kind <= 2:
        scan.skip((1, 3, 6)[kind])
    elif kind == 4:
        scan.skip(18)
    elif kind in (3, 5):
        scan.skip(2)
        start = scan.position
        (_walk_string if kind == 3 else _walk_text)(scan)
        if scan.data[start : start + 4] == b"\xff\xff\xff\xff":
            raise scan.refuse("a NodeId without an identifier")
    else:
        raise scan.refuse(f"NodeId encoding {kind}")
    if encoding & 0x80:
        _walk_string(scan)
    if encoding & 0x40:
        scan.skip(4)


def _walk_variant(scan: Scan) -> None:
    mask = scan.byte()
    kind = mask & 0x3F
    if kind > 31:
        raise scan.refuse(f"built-in type {kind}")
    step = _BUILTIN[kind]() if kind <= 25 else _TEXT_STEP
    if not mask & 0x80:
        if mask & 0x40:
            raise scan.refuse("dimensions of a scalar")
        if kind == 24:
            # OPC 10000-6 5.2.2.16: the value shall not be a Variant, but may be an array of them.
            raise scan.refuse("a Variant in a Variant")
        scan.charge_built(step.memory)
        scan.descend()
        step.walk(scan)
        scan.depth -= 1
        return
    if kind == 0:
        # A Null has no bytes, so that its count could not be held against anything.
        raise scan.refuse("an array of Nulls")
    before = scan.position
    scan.descend()
    count = _walk_array(scan, step)
    scan.depth -= 1
    if mask & 0x40:
        _walk_dimensions(scan, count, null=scan.data[before : before + 4] == b"\xff\xff\xff\xff")


def _walk_dimensions(scan: Scan, count: int, *, null: bool) -> None:
    dimensions = scan.count(4)
    if not 1 <= dimensions <= _MOST_DIMENSIONS:
        raise scan.refuse(f"{dimensions} dimensions")
    lengths = struct.unpack_from(f"<{dimensions}i", scan.data, scan.position)
    scan.skip(4 * dimensions)
    product, lists = 1, 0
    for length in lengths:
        if length < 0 or (null and length):
            raise scan.refuse(f"a dimension of {length}")
        lists += product
        product *= length
        # Each list of every level is built; with an element in each the innermost ones are as many as the elements.
        if product > count:
            raise scan.refuse(f"dimensions of more than {count} elements")
    if product != count:
        raise scan.refuse(f"dimensions of {product} elements for {count}")
    # asyncua makes the lists of each level of slices of those above, which are all kept until the last level is made.
    scan.charge_built(lists * 64 + count * 8 * dimensions)


def _walk_array(scan: Scan, step: TypeStep) -> int:
    """Walk an array; the number of its elements."""
    count = scan.count(step.least)
    if step.number:
        assert step.size is not None
        # Numbers of one byte are shared, the others are objects; both stand in two lists for a moment.
        scan.charge(count * (48 if step.size > 1 or step is _SBYTE else 16))
        scan.skip(count * step.size)
        return count
    # No element, however small, is free; so that no count is larger than what is left.
    scan.charge_built(count * step.memory)
    if step.size is not None:
        scan.skip(count * step.size)
        return count
    walk = step.walk
    for _ in range(count):
        walk(scan)
    return count


def _walk_extension_object(scan: Scan) -> None:
    start = scan.position
    _walk_node_id(scan)
    type_end = scan.position
    encoding = scan.byte()
    if encoding == 0:
        return
    if encoding != 1:
        raise scan.refuse(f"an ExtensionObject with encoding {encoding}")
    length = scan.int32()
    if length < -1 or max(length, 0) > scan.end - scan.position:
        raise scan.refuse(f"a body of {length} bytes")
    if length == -1:
        # For any other type asyncua would read on to the message's end.
        if nodeid_from_binary(Buffer(scan.data[start:type_end])).Identifier != 0:
            raise scan.refuse("a structure without a body")
        return
    known = _known(scan.data[start:type_end])
    end, scan.end = scan.end, scan.position + length
    if known is not None:
        scan.charge_built(known.memory)
        scan.descend()
        known.walk(scan)
        scan.depth -= 1
    scan.position, scan.end = scan.end, end


def _known(type_id: bytes) -> TypeStep | None:
    """How the body of an ExtensionObject is walked, None for one that asyncua leaves as bytes."""
    step = _FOUND.get(type_id)
    if step is None:
        found = ua.extension_objects_by_typeid.get(nodeid_from_binary(Buffer(type_id)))
        if found is not None:
            step = step_of(found)
            if len(_FOUND) < _MOST_FOUND:
                _FOUND[type_id] = step
    return step


_FOUND: Final[dict[bytes, TypeStep]] = {}
"""What was found, never what was not: a nodeset may bring it later."""
_MOST_FOUND: Final = 1_000


@functools.cache
def _data_value() -> TypeStep:
    step = _structure(ua.DataValue)

    def walk(scan: Scan) -> None:
        start = scan.position
        step.walk(scan)
        if (at := misplaced(scan.data[start], scan.position)) >= 0 and not scan.depth:
            scan.misplaced.append(at)

    return dataclasses.replace(step, walk=walk)


def _walk_deferred(kind: Any) -> Callable[[Scan], None]:
    """For types that contain themselves."""

    def walk(scan: Scan) -> None:
        scan.charge_built(_OBJECT)
        scan.descend()
        step_of(kind).walk(scan)
        scan.depth -= 1

    return walk


def _walk_undecodable(scan: Scan) -> None:
    raise scan.refuse("a structure that this server does not know")


_UNDECODABLE: Final = TypeStep(_walk_undecodable, 1, _OBJECT)
"""For types of which asyncua cannot resolve a field: it fails on them, too."""
_TEXT_STEP: Final = TypeStep(_walk_text, 4, _TEXT)
_STRING_STEP: Final = TypeStep(_walk_string, 4, _TEXT)
_NODE_ID_STEP: Final = TypeStep(_walk_node_id, 2, 256)
_SBYTE: Final = _fixed(1, number=True)
_PRIMITIVES: Final[dict[str, TypeStep]] = {
    "SByte": _SBYTE,
    "Byte": _fixed(1, 8, number=True),
    "Char": _fixed(1, 8, number=True),
    "Boolean": _fixed(1, 8, number=True),
    "Int16": _fixed(2, number=True),
    "UInt16": _fixed(2, number=True),
    "Int32": _fixed(4, number=True),
    "UInt32": _fixed(4, number=True),
    "Int64": _fixed(8, number=True),
    "UInt64": _fixed(8, number=True),
    "Float": _fixed(4, number=True),
    "Double": _fixed(8, number=True),
    "Null": _fixed(0),
    "String": _STRING_STEP,
    "Bytes": _TEXT_STEP,
    "ByteString": _TEXT_STEP,
    "CharArray": _STRING_STEP,
    "DateTime": _fixed(8, 96),
    "Guid": _fixed(16, 192),
}
_SPECIAL: Final[dict[str, TypeStep]] = {
    "NodeId": _NODE_ID_STEP,
    "ExpandedNodeId": _NODE_ID_STEP,
    "Variant": TypeStep(_walk_variant, 1, _OBJECT),
    "ExtensionObject": TypeStep(_walk_extension_object, 3, _OBJECT + 256),
}


def step_of(kind: Any) -> TypeStep:
    """How a type of asyncua's is walked."""
    name = getattr(kind, "__name__", "")
    if kind is ua.DataValue:
        return _data_value()
    found = _PRIMITIVES.get(name) or _SPECIAL.get(name)
    return found if found is not None else _structure(kind)


@functools.cache
def _structure(kind: Any) -> TypeStep:
    """A dataclass or an enumeration; as asyncua's `_create_dataclass_deserializer` reads it."""
    if not isinstance(kind, type) or not (is_dataclass(kind) or issubclass(kind, Enum)):
        return _UNDECODABLE
    if issubclass(kind, Enum):
        flags: Any = kind
        name = str(flags.datatype()) if issubclass(kind, IntFlag) and hasattr(kind, "datatype") else "UInt32"
        return _PRIMITIVES[name] if issubclass(kind, IntFlag) else _fixed(4)
    if issubclass(kind, ua.UaUnion):
        return _union(kind)
    try:
        parts = steps_of(kind)
    except (AttributeError, NameError, TypeError):
        return _UNDECODABLE
    if not any(part.switch for part in parts) and all(part.step.size is not None for part in parts):
        size = sum(part.step.size or 0 for part in parts)
        return _fixed(size, _OBJECT + sum(part.step.memory for part in parts))
    runs = _runs(parts)

    def walk(scan: Scan) -> None:
        mask = 0
        for switch, size, step in runs:
            if switch:
                if switch > 0:
                    if not mask & switch:
                        continue
                else:
                    mask = scan.data[scan.position] if scan.position < scan.end else 0
                    if size == 4:
                        mask = int.from_bytes(scan.data[scan.position : scan.position + 4], "little")
            if step is None:
                scan.position += size
                if scan.position > scan.end:
                    raise scan.refuse("the message ends")
            else:
                step(scan)

    memory = _OBJECT + sum(part.step.memory for part in parts)
    return TypeStep(walk, sum(0 if part.switch > 0 else part.step.least for part in parts), memory)


@dataclass(frozen=True, slots=True)
class FieldPart:
    """One field of a structure."""

    name: str
    kind: Any
    """Its type, or that of its elements."""
    step: TypeStep
    element: TypeStep | None
    """How an element is walked, for an array."""
    switch: int
    """The bit of the structure's encoding mask that says whether it is there; 0 for always, -1 for the mask itself."""

    @property
    def is_array(self) -> bool:
        """Whether it is an array."""
        return self.element is not None


@functools.cache
def steps_of(structure: Any) -> tuple[FieldPart, ...]:
    """The fields of a structure in their order."""
    hints = get_safe_type_hints(structure, {"ua": ua})
    parts: list[FieldPart] = []
    bits = 0
    for field in fields(structure):
        kind, switch = hints[field.name], 0
        if type_is_optional(kind):
            switch = 1 << bits
            bits += 1
            kind = type_from_optional(kind)
        if field.name == "Encoding":
            switch = -1
        if type_allow_subclass(kind):
            parts.append(FieldPart(field.name, ua.ExtensionObject, _SPECIAL["ExtensionObject"], None, switch))
            continue
        is_array, kind = _element(kind)
        inner = TypeStep(_walk_deferred(kind), 1, 0) if kind is structure else step_of(kind)
        step, element = (_array(inner), inner) if is_array else (inner, None)
        parts.append(FieldPart(field.name, kind, step, element, switch))
    return tuple(parts)


def _element(kind: Any) -> tuple[bool, Any]:
    """Whether a field is an array, and the type of the field or its elements; as asyncua resolves it."""
    kind, is_optional = resolve_uatype(kind)
    if not is_optional and type_is_union(kind):
        is_array, kind = types_or_list_from_union(kind)
        if not is_array:
            return _element(kind)
    if type_is_list(kind):
        return True, resolve_uatype(type_from_list(kind))[0]
    return False, kind


def _array(step: TypeStep) -> TypeStep:
    def walk(scan: Scan) -> None:
        _walk_array(scan, step)

    return TypeStep(walk, 4, 64)


def _runs(parts: tuple[FieldPart, ...]) -> list[tuple[int, int, Callable[[Scan], None] | None]]:
    """The fields as (switch, size, walk), with neighbours of fixed size as one."""
    runs: list[tuple[int, int, Callable[[Scan], None] | None]] = []
    for part in parts:
        if part.step.size is None:
            runs.append((part.switch, 0, part.step.walk))
        elif part.switch == 0 and runs and runs[-1][0] == 0 and runs[-1][2] is None:
            runs[-1] = (0, runs[-1][1] + part.step.size, None)
        else:
            runs.append((part.switch, part.step.size, None))
    return runs


def _union(kind: Any) -> TypeStep:
    alternatives: list[TypeStep] = []
    for alternative in kind._union_types:  # noqa: SLF001 - asyncua's decoder reads it too
        is_array, inner = _element(alternative)
        step = step_of(inner)
        alternatives.append(_array(step) if is_array else step)

    def walk(scan: Scan) -> None:
        chosen = scan.int32()
        if 0 < chosen <= len(alternatives):
            scan.charge_built(alternatives[chosen - 1].memory)
            alternatives[chosen - 1].walk(scan)

    return TypeStep(walk, 4, _OBJECT)


_BUILTIN: Final[tuple[Callable[[], TypeStep], ...]] = tuple(
    functools.partial(step_of, getattr(ua, member.name, type(member.name, (), {}))) for member in ua.VariantType
)
