"""Structures as bytes: a function for each class, made of its fields when the first one is encoded.

The fields are those that `scan` reads requests by, so that there is one reading of asyncua's classes. Neighbours of a
fixed size are packed in one go. A test holds the bytes of generated structures against asyncua's encoder.
"""

# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from enum import Enum, IntFlag
from typing import Any, Final

from asyncua import ua
from asyncua.ua.ua_binary import (
    create_list_serializer,
    create_type_serializer,
    extensionobject_to_binary,
    struct_to_binary,
)

from ua_fleet.endpoint.binary.builtin import (
    NUMBERS,
    encode_diagnostic_info,
    encode_localized_text,
    encode_node_id,
    encode_qualified_name,
    encode_string,
    encode_time,
    encode_variant,
)
from ua_fleet.endpoint.binary.data_values import encode_data_value
from ua_fleet.endpoint.scan import FieldPart, steps_of

__all__ = ["NO_OBJECT", "EncodedArray", "encode", "encode_array", "encode_extension_object"]

_Encoder = Callable[[Any], bytes]


class EncodedArray(bytes):
    """An array of a structure as bytes, which stands in the structure in place of its elements."""

    __slots__ = ()


_LENGTH: Final = struct.Struct("<i")
_NULL: Final = b"\xff\xff\xff\xff"
NO_OBJECT: Final = b"\x00\x00\x00"
"""An ExtensionObject without a type and a body."""


def encode(structure: Any) -> bytes:
    """A structure as bytes; raises what asyncua raises."""
    encoder = _ENCODERS.get(type(structure))
    if encoder is None:
        encoder = _encoder_of(type(structure))
    return encoder(structure)


def encode_array(structures: Sequence[Any]) -> EncodedArray:
    """An array of structures."""
    return EncodedArray(_LENGTH.pack(len(structures)) + b"".join(map(encode, structures)))


def encode_extension_object(structure: Any) -> bytes:
    """An ExtensionObject, or a structure in one."""
    if type(structure) is ua.ExtensionObject and structure.Body is None:
        head = encode_node_id(structure.TypeId) + b"\x00"
        if head == NO_OBJECT:
            return head
    type_id = ua.typeid_by_extension_objects.get(type(structure)) if structure is not None else None
    if type_id is None or isinstance(structure, ua.ExtensionObject):
        data: bytes = extensionobject_to_binary(structure)
        return data
    body = encode(structure)
    head = encode_node_id(type_id) + b"\x01"
    return head + _LENGTH.pack(len(body)) + body if body else head


def _encoder_of(kind: type) -> _Encoder:
    """The function for a class; asyncua's own for what is no plain structure."""
    known = _ENCODERS.get(kind)
    if known is not None:
        return known
    if not is_dataclass(kind) or issubclass(kind, ua.UaUnion):
        return struct_to_binary
    try:
        encoder = _compiled(kind, steps_of(kind))
    except (AttributeError, NameError, TypeError):
        encoder = struct_to_binary
    _ENCODERS[kind] = encoder
    return encoder


def _compiled(kind: type, parts: tuple[FieldPart, ...]) -> _Encoder:
    names: dict[str, Any] = {}
    pieces: list[str] = []
    run: list[tuple[str, str]] = []

    def close_run() -> None:
        if run:
            names[f"p{len(names)}"] = struct.Struct("<" + "".join(code for code, _ in run)).pack
            pieces.append(f"p{len(names) - 1}({', '.join(value for _, value in run)})")
            run.clear()

    bits = [part for part in parts if part.switch > 0]
    for part in parts:
        value = f"s.{part.name}"
        if part.name == "Encoding":
            mask = " | ".join(f"({bit.switch} if s.{bit.name} is not None else 0)" for bit in bits) or "0"
            run.append((NUMBERS[part.kind.__name__], mask))
            continue
        fixed = None if part.is_array or part.switch else _fixed(part.kind, value)
        if fixed is not None:
            run.append(fixed)
            continue
        close_run()
        names[f"e{len(names)}"] = _field_encoder(part, kind)
        call = f"e{len(names) - 1}({value})"
        pieces.append(f"(b'' if {value} is None else {call})" if part.switch else call)
    close_run()
    joined = f"b''.join(({', '.join(pieces)},))" if len(pieces) > 1 else "".join(pieces) or "b''"
    # The source has names of fields and numbers in it, and nothing that came from outside.
    made: _Encoder = eval(f"lambda s: {joined}", names)  # noqa: S307
    return made


def _fixed(kind: Any, value: str) -> tuple[str, str] | None:
    """How `struct` packs a type, and what it packs."""
    if kind is ua.StatusCode:
        return "I", f"{value}.value"
    if isinstance(kind, type) and issubclass(kind, Enum):
        if issubclass(kind, IntFlag):
            flags: Any = kind
            return NUMBERS[flags.datatype() if hasattr(kind, "datatype") else "UInt32"], value
        return "i", value
    code = NUMBERS.get(getattr(kind, "__name__", ""))
    return None if code is None else (code, value)


def _field_encoder(part: FieldPart, owner: type) -> _Encoder:
    kind = part.kind
    if part.is_array:
        if getattr(kind, "__name__", "") in NUMBERS:
            numbers: _Encoder = create_list_serializer(kind)
            return numbers
        return _list_of(_one(kind, owner))
    return _one(kind, owner)


def _one(kind: Any, owner: type) -> _Encoder:
    found = _SPECIAL.get(getattr(kind, "__name__", ""))
    if found is not None:
        return found
    if kind is owner:
        return encode
    if (fixed := _fixed(kind, "s")) is not None:
        pack = struct.Struct("<" + fixed[0]).pack
        return (lambda code: pack(code.value)) if kind is ua.StatusCode else pack
    if isinstance(kind, type) and is_dataclass(kind):
        return _encoder_of(kind)
    rare: _Encoder = create_type_serializer(kind)
    return rare


def _list_of(one: _Encoder) -> _Encoder:
    def encode_list(values: Any) -> bytes:
        if values is None:
            return _NULL
        if type(values) is EncodedArray:
            return values
        return _LENGTH.pack(len(values)) + b"".join([one(value) for value in values])

    return encode_list


_SPECIAL: Final[dict[str, _Encoder]] = {
    "String": encode_string,
    "CharArray": encode_string,
    "ByteString": encode_string,
    "Bytes": encode_string,
    "DateTime": encode_time,
    "NodeId": encode_node_id,
    "ExpandedNodeId": encode_node_id,
    "QualifiedName": encode_qualified_name,
    "LocalizedText": encode_localized_text,
    "Variant": encode_variant,
    "DataValue": encode_data_value,
    "DiagnosticInfo": encode_diagnostic_info,
    "ExtensionObject": encode_extension_object,
}
_ENCODERS: Final[dict[type, _Encoder]] = {
    ua.QualifiedName: encode_qualified_name,
    ua.LocalizedText: encode_localized_text,
    ua.DiagnosticInfo: encode_diagnostic_info,
    ua.DataValue: encode_data_value,
    ua.ExtensionObject: struct_to_binary,
}
