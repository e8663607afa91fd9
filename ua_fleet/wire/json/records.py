"""Structures of the specification as JSON objects, from tables of their members (OPC 10000-6 5.4.6, CompactEncoding).

A `Member` reads and writes one kind of value. A record's members are in the order of the fields of the NamedTuple that
it becomes. What is absent has its default, and what has its default is not written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple, cast

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import BuiltinType, ExtensionObject, Variant
from ua_fleet.wire.json.causes import JsonCause
from ua_fleet.wire.json.node_ids import decode_node_id
from ua_fleet.wire.json.parsing import Reading, shown
from ua_fleet.wire.json.scalars import DEFAULTS, SCALAR_DECODERS, SCALAR_ENCODERS
from ua_fleet.wire.json.structures import decode_enumeration, decode_extension_object, encode_extension_object
from ua_fleet.wire.json.variants import Writing, decode_variant, encode_variant

__all__ = [
    "BOOLEAN",
    "BYTE",
    "BYTE_STRING",
    "DOUBLE",
    "ENUMERATION",
    "GUID",
    "INT32",
    "INT64",
    "LOCALIZED_TEXT",
    "NODE_ID",
    "QUALIFIED_NAME",
    "STRING",
    "TEXT",
    "TIME",
    "UINT16",
    "UINT32",
    "VARIANT",
    "Member",
    "Record",
    "array",
    "extension",
    "nested",
    "record",
]


class Member(NamedTuple):
    """How values of one kind are read and written."""

    decode: Callable[[Reading, Any], Any]
    encode: Callable[[tuple[str, ...], Any], Any]
    """(namespaces, value) -> what JSON holds; None is left out."""


class Record(NamedTuple):
    """A structure."""

    kind: type
    make: Callable[..., Any]
    """Makes one of the values of its members, in their order."""
    split: Callable[[Any], Iterable[Any]]
    """The values of its members."""
    names: tuple[str, ...]
    members: tuple[Member, ...]

    def decode(self, reading: Reading, value: Any) -> Any:
        """The NamedTuple of an object; null is one of defaults."""
        if value is None:
            value = {}
        if value.__class__ is not dict:
            raise RemoteWireError(JsonCause.SHAPE, f"{shown(value)} is no {self.kind.__name__}")
        return self.make(
            *[member.decode(reading, value.get(name)) for name, member in zip(self.names, self.members, strict=True)]
        )

    def encode(self, namespaces: tuple[str, ...], value: Any) -> dict[str, Any]:
        """The object of a NamedTuple."""
        if type(value) is not self.kind:
            raise LocalWireError(f"{value!r:.80} is no {self.kind.__name__}")
        out: dict[str, Any] = {}
        for name, member, part in zip(self.names, self.members, self.split(value), strict=True):
            held = member.encode(namespaces, part)
            if held is not None:
                out[name] = held
        return out


def _scalar(kind: BuiltinType) -> Member:
    default = DEFAULTS.get(kind)
    read, write = SCALAR_DECODERS[kind], SCALAR_ENCODERS[kind]

    def decode(reading: Reading, value: Any) -> Any:
        return default if value is None else read(reading, value)

    def encode(namespaces: tuple[str, ...], value: Any) -> Any:
        held = write(namespaces, False, value)
        return None if value == default else held

    return Member(decode, encode)


def _decode_text(reading: Reading, value: Any) -> str:
    return SCALAR_DECODERS[BuiltinType.STRING](reading, value) or ""


def _encode_text(namespaces: tuple[str, ...], value: Any) -> Any:
    return SCALAR_ENCODERS[BuiltinType.STRING](namespaces, False, value) or None


def _decode_enumeration(reading: Reading, value: Any) -> int:
    return 0 if value is None else decode_enumeration(reading, value)


BOOLEAN: Final = _scalar(BuiltinType.BOOLEAN)
BYTE: Final = _scalar(BuiltinType.BYTE)
UINT16: Final = _scalar(BuiltinType.UINT16)
INT32: Final = _scalar(BuiltinType.INT32)
UINT32: Final = _scalar(BuiltinType.UINT32)
INT64: Final = _scalar(BuiltinType.INT64)
DOUBLE: Final = _scalar(BuiltinType.DOUBLE)
TIME: Final = _scalar(BuiltinType.DATETIME)
STRING: Final = _scalar(BuiltinType.STRING)
TEXT: Final = Member(_decode_text, _encode_text)
"""A String of which null and empty are the same."""
BYTE_STRING: Final = _scalar(BuiltinType.BYTE_STRING)
GUID: Final = _scalar(BuiltinType.GUID)
NODE_ID: Final = _scalar(BuiltinType.NODE_ID)
QUALIFIED_NAME: Final = _scalar(BuiltinType.QUALIFIED_NAME)
LOCALIZED_TEXT: Final = _scalar(BuiltinType.LOCALIZED_TEXT)
ENUMERATION: Final = Member(_decode_enumeration, INT32.encode)


def _encode_variant(namespaces: tuple[str, ...], value: Any) -> Any:
    return encode_variant(Writing(namespaces, verbose=False), value)


def _decode_variant(reading: Reading, value: Any) -> Variant:
    return decode_variant(reading, value)


VARIANT: Final = Member(_decode_variant, _encode_variant)


def record(kind: type, **members: Member) -> Record:
    """A structure that becomes a NamedTuple, whose fields are members of these names in this order."""
    return Record(kind, kind, tuple, tuple(members), tuple(members.values()))


def nested(inner: Record) -> Member:
    """A structure as a member of another one; one of defaults alone is left out."""

    def encode(namespaces: tuple[str, ...], value: Any) -> dict[str, Any] | None:
        return inner.encode(namespaces, value) or None

    return Member(inner.decode, encode)


def array(element: Member | Record) -> Member:
    """An array, which becomes a tuple; null is empty, and empty is left out."""

    def decode(reading: Reading, value: Any) -> tuple[Any, ...]:
        if value is None:
            return ()
        if value.__class__ is not list:
            raise RemoteWireError(JsonCause.SHAPE, f"{shown(value)} is no array")
        return tuple([element.decode(reading, part) for part in cast("list[object]", value)])

    def encode(namespaces: tuple[str, ...], value: Any) -> Any:
        # Elements are never left out: null stands for the default of a nullable type only.
        parts = [element.encode(namespaces, part) for part in value]
        return [_whole(part, raw) for part, raw in zip(parts, value, strict=True)] or None

    return Member(decode, encode)


def _whole(held: Any, value: Any) -> Any:
    """An element that has its default, written all the same."""
    return value if held is None and isinstance(value, bool | int | float | str) else held


def extension(known: Mapping[int, Record] | None = None) -> Member:
    """A structure of which subtypes are allowed: an ExtensionObject.

    Args:
        known: by the number of their DataType in namespace 0, the structures that are decoded. Others stay
            ExtensionObjects; None stands for null.
    """
    records = known or {}
    numbers: dict[object, int] = {known_record.kind: number for number, known_record in records.items()}

    def decode(reading: Reading, value: Any) -> Any:
        if value is None or value == {}:
            return None
        if value.__class__ is dict and "UaTypeId" in value and "UaBody" not in value:
            namespace, number = decode_node_id(reading, value["UaTypeId"])
            its_record = records.get(number) if namespace == 0 and isinstance(number, int) else None
            if its_record is not None:
                return its_record.decode(reading, value)
        return decode_extension_object(reading, value)

    def encode(namespaces: tuple[str, ...], value: Any) -> Any:
        if value is None:
            return None
        number = numbers.get(value.__class__)
        if number is not None:
            return {"UaTypeId": f"i={number}", **records[number].encode(namespaces, value)}
        if not isinstance(value, ExtensionObject):
            raise LocalWireError(f"{value!r:.80} is no structure")
        return encode_extension_object(Writing(namespaces, verbose=False), value)

    return Member(decode, encode)
