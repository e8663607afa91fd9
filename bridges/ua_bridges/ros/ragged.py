"""Arrays of messages that have no flat form (messages with arrays in them), as JSON in one String.

The JSON has the names of the wire, base64 for arrays of bytes, and "NaN", "Infinity", "-Infinity" as OPC 10000-6
5.4.2.4 has them.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import Any, Final, TypeGuard

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros.leaves import OCTETS
from ua_bridges.ros.scalars import (
    Convert,
    array_writer,
    check_length,
    is_array,
    octets_reader,
    octets_writer,
    scalar_writer,
)
from ua_bridges.ros.schema import Member, MessageSchema

__all__ = ["ragged_reader", "ragged_writer"]

_NOT_FINITE: Final = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}


def _plain_scalar(value: Any, member: Member, schema: MessageSchema) -> Any:
    if member.type == "byte":
        return value & 0xFF if schema.ros == 1 else value[0]
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def _plain_member(message: Any, member: Member, schema: MessageSchema) -> Any:
    value = attrgetter(member.attribute)(message)
    if member.nested is not None:
        nested = member.nested
        return [_plain(item, nested) for item in value] if member.array else _plain(value, nested)
    if not member.array:
        return _plain_scalar(value, member, schema)
    if member.type in OCTETS:
        return base64.b64encode(octets_reader(member, schema.ros)(value)).decode()
    items = value.tolist() if hasattr(value, "tolist") else value
    return [_plain_scalar(item, member, schema) for item in items]


def _plain(message: Any, schema: MessageSchema) -> dict[str, Any]:
    return {member.name: _plain_member(message, member, schema) for member in schema.members}


def ragged_reader(member: Member) -> Convert:
    """Makes the JSON text of an array of messages."""
    schema = member.nested
    assert schema is not None

    def read(messages: Any) -> str:
        return json.dumps([_plain(message, schema) for message in messages], ensure_ascii=False, separators=(",", ":"))

    return read


def _is_object(value: object) -> TypeGuard[Mapping[str, Any]]:
    return isinstance(value, dict)


def _object(value: Any, field: str) -> Mapping[str, Any]:
    if not _is_object(value):
        raise ConversionError(field, "the JSON has no object here")
    return value


def _array(value: Any, field: str) -> Sequence[Any]:
    if not is_array(value):
        raise ConversionError(field, "the JSON has no array here")
    return value


def _float_of(value: Any, member: Member) -> Any:
    if member.type in ("float32", "float64") and isinstance(value, str):
        return _NOT_FINITE.get(value, value)
    return value


class _Builder:
    """Makes the messages of one array from JSON that has been parsed."""

    def __init__(self, make: Callable[[str], Any]) -> None:
        self._make = make

    def messages(self, value: Any, member: Member, field: str) -> list[Any]:
        items = _array(value, field)
        check_length(len(items), member)
        assert member.nested is not None
        return [self._message(item, member.nested, f"{field}[{index}]") for index, item in enumerate(items)]

    def _message(self, value: Any, schema: MessageSchema, field: str) -> Any:
        source, message = _object(value, field), self._make(schema.native)
        for member in schema.members:
            name = f"{field}.{member.name}"
            if member.name not in source:
                raise ConversionError(name, "missing in the JSON")
            try:
                converted = self._member(source[member.name], member, schema, name)
            except (TypeError, ValueError, OverflowError) as error:
                raise ConversionError(name, str(error)) from error
            parent, _, last = member.attribute.rpartition(".")
            setattr(attrgetter(parent)(message) if parent else message, last, converted)
        return message

    def _member(self, value: Any, member: Member, schema: MessageSchema, name: str) -> Any:
        if member.nested is not None:
            return self.messages(value, member, name) if member.array else self._message(value, member.nested, name)
        if not member.array:
            return scalar_writer(member, schema.ros)(_float_of(value, member))
        if member.type in OCTETS:
            return octets_writer(member, schema.ros)(base64.b64decode(value, validate=True))
        return array_writer(member, schema.ros, name)([_float_of(item, member) for item in _array(value, name)])


def ragged_writer(member: Member, field: str, make: Callable[[str], Any]) -> Convert:
    """Makes an array of messages from its JSON text."""
    builder = _Builder(make)

    def write(text: Any) -> list[Any]:
        if not isinstance(text, str):
            raise TypeError(f"a {type(text).__name__} is not a string with JSON")
        try:
            parsed = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ConversionError(field, f"not JSON: {error}") from error
        return builder.messages(parsed, member, field)

    return write
