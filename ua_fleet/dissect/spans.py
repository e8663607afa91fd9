"""Spans: what each byte of a message is called and says, down to the values of its fields (OPC 10000-6 5.2).

Whatever is decoded here is decoded by the decoders of this package. Only what those take apart without a trace, a
string's length, an array's elements, a DataValue's parts, is taken in the same steps once more.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Sequence
from struct import Struct
from typing import Any, Final, NamedTuple

from ua_fleet.printing import harmless
from ua_fleet.values import (
    ARRAY,
    DIMENSIONS,
    BuiltinType,
    ExpandedNodeId,
    LocalizedText,
    NodeId,
    QualifiedName,
    datetime_from_ticks,
    status_name,
)
from ua_fleet.wire.builtin import FIXED
from ua_fleet.wire.cursor import Cursor
from ua_fleet.wire.variant import (
    DECODERS,
    HAS_SERVER_PICOSECONDS,
    HAS_SERVER_TIMESTAMP,
    HAS_SOURCE_PICOSECONDS,
    HAS_SOURCE_TIMESTAMP,
    HAS_STATUS,
    HAS_VALUE,
    LAST_ASSIGNED,
    SMALLEST,
    TYPE_BITS,
)

__all__ = ["ByteSpan", "Flag", "MessageWalk", "flags_text", "type_name", "value_text"]

Flag = tuple[int, str]
"""A bit and what it says when it is set."""

TYPE_NAMES: Final[dict[int, str]] = {
    BuiltinType.NULL: "Null",
    BuiltinType.SBYTE: "SByte",
    BuiltinType.UINT16: "UInt16",
    BuiltinType.UINT32: "UInt32",
    BuiltinType.UINT64: "UInt64",
    BuiltinType.DATETIME: "DateTime",
    BuiltinType.BYTE_STRING: "ByteString",
    BuiltinType.XML_ELEMENT: "XmlElement",
    BuiltinType.NODE_ID: "NodeId",
    BuiltinType.EXPANDED_NODE_ID: "ExpandedNodeId",
    BuiltinType.STATUS_CODE: "StatusCode",
    BuiltinType.QUALIFIED_NAME: "QualifiedName",
    BuiltinType.LOCALIZED_TEXT: "LocalizedText",
    BuiltinType.EXTENSION_OBJECT: "ExtensionObject",
    BuiltinType.DATA_VALUE: "DataValue",
    BuiltinType.DIAGNOSTIC_INFO: "DiagnosticInfo",
}
"""The names of OPC 10000-6 table 1, where they are not the enumeration's own in lower case."""

COUNTED: Final = (BuiltinType.STRING, BuiltinType.BYTE_STRING, BuiltinType.XML_ELEMENT)
"""Types that are an Int32 length and so many bytes."""

DATA_VALUE_FLAGS: Final[tuple[Flag, ...]] = (
    (HAS_VALUE, "Value"),
    (HAS_STATUS, "Status"),
    (HAS_SOURCE_TIMESTAMP, "SourceTimestamp"),
    (HAS_SERVER_TIMESTAMP, "ServerTimestamp"),
    (HAS_SOURCE_PICOSECONDS, "SourcePicoSeconds"),
    (HAS_SERVER_PICOSECONDS, "ServerPicoSeconds"),
)

_INT32 = Struct("<i")


def type_name(code: int) -> str:
    """The name of a type code: `Double`, `Double[]`, and `Double[][]` for what has dimensions."""
    kind = code & TYPE_BITS
    name = TYPE_NAMES.get(kind) or (BuiltinType(kind).name.capitalize() if kind <= LAST_ASSIGNED else f"type {kind}")
    return name + ("[]" if code & ARRAY else "") + ("[]" if code & DIMENSIONS else "")


def flags_text(value: int, flags: Sequence[Flag]) -> str:
    """The names of the bits that are set."""
    return ", ".join(name for bit, name in flags if value & bit) or "none"


def _number_text(kind: int, value: Any) -> str:
    if kind == BuiltinType.BOOLEAN:
        return "true" if value else "false"
    if kind == BuiltinType.DATETIME:
        return datetime_from_ticks(value).isoformat().replace("+00:00", "Z")
    return status_name(value) if kind == BuiltinType.STATUS_CODE else str(value)


def value_text(kind: int, value: Any) -> str:
    """A value of a built-in type for people."""
    if value is None:
        return "null"
    if kind in FIXED:
        return _number_text(kind, value)
    if isinstance(value, str):
        return f'"{harmless(value)}"'
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, NodeId):
        letter = {int: "i", str: "s", uuid.UUID: "g", bytes: "b"}[type(value.identifier)]
        identifier = value.identifier.hex() if isinstance(value.identifier, bytes) else value.identifier
        return f"ns={value.namespace};{letter}={harmless(str(identifier))}"
    if isinstance(value, ExpandedNodeId):
        namespace = f"nsu={value.namespace_uri};" if value.namespace_uri is not None else ""
        return f"svr={value.server_index};{harmless(namespace)}{value_text(BuiltinType.NODE_ID, value.node_id)}"
    if isinstance(value, QualifiedName):
        return f"{value.namespace}:{harmless(str(value.name))}"
    if isinstance(value, LocalizedText):
        return value_text(kind, value.text) + (f" ({harmless(value.locale)})" if value.locale else "")
    return harmless(str(value))


class ByteSpan(NamedTuple):
    """Some bytes of a message and what they are."""

    offset: int
    data: bytes
    section: str
    """The part of the message that it belongs to."""
    name: str
    """As the specification calls it."""
    value: Any
    """As the decoder gives it; None where it is not a value of its own."""
    meaning: str


class MessageWalk:
    """Goes through a message with a Cursor and notes a span for everything that it reads."""

    def __init__(self, data: bytes, position: int = 0, end: int | None = None) -> None:
        self.cursor = Cursor(data, position, end)
        self.spans: list[ByteSpan] = []
        self.section = ""

    def note(self, name: str, start: int, value: Any, meaning: str) -> None:
        """Note what stands between `start` and the cursor; nothing where nothing was read."""
        cursor = self.cursor
        if cursor.position > start:
            data = cursor.data[start : cursor.position]
            self.spans.append(ByteSpan(start, data, self.section, name, value, meaning))

    def read(self, name: str, decode: Callable[[Cursor], Any], meaning: Callable[[Any], str] = str) -> Any:
        """Decode something and note it."""
        start = self.cursor.position
        value = decode(self.cursor)
        self.note(name, start, value, meaning(value))
        return value

    def number(self, name: str, kind: int, said: str = "") -> Any:
        """A number of one of the types of fixed size."""
        return self.read(name, DECODERS[kind], lambda value: _number_text(kind, value) + said)

    def flags(self, name: str, flags: Sequence[Flag], first: Callable[[int], str] | None = None) -> int:
        """A Byte of flags, spelled out; `first` says what bits mean that are no flags."""

        def meaning(value: int) -> str:
            parts = [first(value)] if first else []
            if not parts or any(value & bit for bit, _ in flags):
                parts.append(flags_text(value, flags))
            return "; ".join(part for part in parts if part)

        value: int = self.read(name, Cursor.byte, meaning)
        return value

    def take(self, name: str, size: int, meaning: str = "") -> None:
        """Bytes that are not looked into."""
        self.read(name, lambda cursor: cursor.take(size), lambda _: meaning or f"{size} bytes")

    def rest(self, name: str, meaning: str = "") -> None:
        """All that is left."""
        self.take(name, self.cursor.remaining, meaning)

    def padding(self) -> None:
        """What may stand behind a message: zeros up to its configured size."""
        self.rest("Padding", "zeros")

    def part(self, size: int) -> MessageWalk:
        """A walk through the next `size` bytes, which this one passes over; its spans come here."""
        start = self.cursor.position
        self.cursor.take(size)
        inner = MessageWalk(self.cursor.data, start, start + size)
        inner.spans, inner.section = self.spans, self.section
        return inner

    def length(self, name: str, smallest: int, what: str) -> int | None:
        """An Int32 count of elements of at least `smallest` bytes."""
        count: int | None = self.read(
            name,
            lambda cursor: cursor.length(smallest),
            lambda count: "null" if count is None else f"{count} {what}",
        )
        return count

    def value(self, name: str, kind: int) -> Any:
        """A scalar of a built-in type; strings with their length, DataValues and Variants part by part.

        Returns the value of what has no parts.
        """
        if kind == BuiltinType.DATA_VALUE:
            self.data_value(name)
        elif kind == BuiltinType.VARIANT:
            self.variant(name)
        elif kind in COUNTED or kind > LAST_ASSIGNED:
            self._counted(name, kind)
        else:
            return self.read(name, DECODERS[kind], lambda value: value_text(kind, value))
        return None

    def _counted(self, name: str, kind: int) -> None:
        start = self.cursor.position
        value = DECODERS[kind](self.cursor)
        end, self.cursor.position = self.cursor.position, start
        self.length(f"{name}.Length", 1, "bytes")
        if value is None:
            self.spans[-1] = self.spans[-1]._replace(name=name, meaning="null")
        self.cursor.position = end
        self.note(name, start + 4, value, value_text(kind, value))

    def variant(self, name: str) -> None:
        """A Variant."""
        code: int = self.read(f"{name}.EncodingMask", Cursor.byte, type_name)
        kind = code & TYPE_BITS
        if kind not in SMALLEST or code in (BuiltinType.VARIANT, BuiltinType.VARIANT | DIMENSIONS):
            return  # nothing follows, or the decoder refuses it
        if code & ARRAY:
            self._array(name, code, kind)
        else:
            self.value(name, kind)

    def _array(self, name: str, code: int, kind: int) -> None:
        count = self.length(f"{name}.ArrayLength", SMALLEST[kind], "elements") or 0
        layout = FIXED.get(kind)
        if layout is not None:
            elements = Struct(f"<{count}{layout.format[1:]}")
            text = f"{count} x {type_name(kind)}"
            self.read(
                name,
                lambda cursor: cursor.unpack(elements),
                lambda values: (
                    ", ".join(_number_text(kind, value) for value in values[:8])
                    + (f", ... ({text})" if count > 8 else "")
                ),
            )
        else:
            self.cursor.descend()
            for index in range(count):
                self.value(f"{name}[{index}]", kind)
            self.cursor.ascend()
        if code & DIMENSIONS:
            for index in range(self.length(f"{name}.ArrayDimensions.Length", 4, "dimensions") or 0):
                self.number(f"{name}.ArrayDimensions[{index}]", BuiltinType.INT32)

    def data_value(self, name: str) -> None:
        """A DataValue."""
        mask = self.flags(f"{name}.EncodingMask", DATA_VALUE_FLAGS)
        if mask & HAS_VALUE:
            self.cursor.descend()
            self.variant(f"{name}.Value")
            self.cursor.ascend()
        for bit, part, kind, said in (
            (HAS_STATUS, "Status", BuiltinType.STATUS_CODE, ""),
            (HAS_SOURCE_TIMESTAMP, "SourceTimestamp", BuiltinType.DATETIME, ""),
            (HAS_SOURCE_PICOSECONDS, "SourcePicoSeconds", BuiltinType.UINT16, " x 10 ps"),
            (HAS_SERVER_TIMESTAMP, "ServerTimestamp", BuiltinType.DATETIME, ""),
            (HAS_SERVER_PICOSECONDS, "ServerPicoSeconds", BuiltinType.UINT16, " x 10 ps"),
        ):
            if mask & bit:
                self.number(f"{name}.{part}", kind, said)
