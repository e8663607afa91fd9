"""Text to values of a node's own type, and values to what JSON and people can read."""

# pyright: reportUnknownVariableType=false
from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from enum import Enum
from typing import Any, Final

from asyncua import ua

from ua_fleet.errors import AccessRefused
from ua_fleet.values import StatusCode

__all__ = ["exact_value", "parse_value", "plain_value"]

_INTEGERS: Final = {
    ua.VariantType.SByte: (-(2**7), 2**7 - 1),
    ua.VariantType.Byte: (0, 2**8 - 1),
    ua.VariantType.Int16: (-(2**15), 2**15 - 1),
    ua.VariantType.UInt16: (0, 2**16 - 1),
    ua.VariantType.Int32: (-(2**31), 2**31 - 1),
    ua.VariantType.UInt32: (0, 2**32 - 1),
    ua.VariantType.Int64: (-(2**63), 2**63 - 1),
    ua.VariantType.UInt64: (0, 2**64 - 1),
}
_NAMED: Final = ua.LocalizedText | ua.StatusCode | ua.NodeId | ua.QualifiedName
"""Structures that stand for one text."""
_NOT_FINITE: Final = ("nan", "inf", "infinity")
_SIZES: Final = {ua.VariantType.Float: "<f", ua.VariantType.Double: "<d"}
_NO_TIME: Final = datetime(1601, 1, 1, tzinfo=UTC)
"""What is before it is encoded as no time at all (OPC 10000-6 5.2.2.5)."""
_LAST_TIME: Final = datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)
"""What is after it is encoded as the end of all times."""
_BOOLEANS: Final = {
    "true": True,
    "1": True,
    "yes": True,
    "on": True,
    "false": False,
    "0": False,
    "no": False,
    "off": False,
}
_HINTS: Final = {
    ua.VariantType.ByteString: "; give it in hexadecimal",
    ua.VariantType.Boolean: "; give true or false",
    ua.VariantType.DateTime: "; give a time like 2030-01-31T12:00:00Z",
    **dict.fromkeys(_INTEGERS, "; give a whole number"),
}


def _mismatch(text: str, kind: ua.VariantType, hint: str = "") -> AccessRefused:
    return AccessRefused(StatusCode.BAD_TYPE_MISMATCH, f"{text!r} is no {kind.name}{hint}")


def _scalar(text: str, kind: ua.VariantType) -> Any:
    try:
        if kind is ua.VariantType.Boolean:
            return _BOOLEANS[text.strip().lower()]
        if kind in _INTEGERS:
            number = int(text, 0)
            low, high = _INTEGERS[kind]
            if not low <= number <= high:
                raise _mismatch(text, kind, f", which goes from {low} to {high}")
            return number
        if kind in _SIZES:
            return _number(text, kind)
        if kind is ua.VariantType.DateTime:
            return _time(text)
        if kind is ua.VariantType.ByteString:
            return bytes.fromhex(text)
    except (ValueError, KeyError):
        raise _mismatch(text, kind, _HINTS.get(kind, "; give a number")) from None
    if kind is ua.VariantType.String:
        return text
    raise AccessRefused(StatusCode.BAD_NOT_SUPPORTED, f"values of type {kind.name} cannot be given as text")


def _number(text: str, kind: ua.VariantType) -> float:
    """A number that stays one: no infinity unless it is written so, and no 0 out of a number that is too small."""
    number = float(text)
    if not math.isfinite(number) and text.strip().lower().lstrip("+-") in _NOT_FINITE:
        return number
    try:
        (held,) = struct.unpack(_SIZES[kind], struct.pack(_SIZES[kind], number))
    except OverflowError:
        held = math.inf
    if not math.isfinite(held):
        raise _mismatch(text, kind, ", it is too large; give a smaller number, or inf")
    if held == 0 and re.search("[1-9]", re.split("[eE]", text)[0]):
        raise _mismatch(text, kind, ", it is too small; give 0")
    return number


def _time(text: str) -> datetime:
    """A time of ISO 8601 in UTC, which it is without a zone, too."""
    moment = datetime.fromisoformat(text)
    try:
        moment = moment.astimezone(UTC) if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
        is_held = _NO_TIME <= moment <= _LAST_TIME
    except OverflowError:
        is_held = False
    if not is_held:
        limits = f"from {_NO_TIME:%Y-%m-%dT%H:%M:%SZ} to {_LAST_TIME:%Y-%m-%dT%H:%M:%SZ}"
        raise _mismatch(text, ua.VariantType.DateTime, f", which goes {limits}")
    return moment


def parse_value(text: str, kind: ua.VariantType, *, array: bool) -> ua.Variant:
    """A Variant of a node's own type from a text; an array is given as JSON, e.g. `[1, 2.5]`.

    Raises:
        AccessRefused: the text is no value of this type.
    """
    if not array:
        return ua.Variant(_scalar(text, kind), kind)
    try:
        # Numbers stay as they are written, so that none is another one, or another text.
        elements: Any = json.loads(text, parse_int=str, parse_float=str, parse_constant=str)
    except json.JSONDecodeError:
        elements = None
    if not isinstance(elements, list):
        raise _mismatch(text, kind, " array; give it as JSON, such as [1, 2]")
    given: Sequence[Any] = elements
    if any(element is None or isinstance(element, list | dict) for element in given):
        raise _mismatch(text, kind, " array; give single values in it, and no null")
    texts = [element if isinstance(element, str) else json.dumps(element) for element in given]
    return ua.Variant([_scalar(element, kind) for element in texts], kind, is_array=True)


def plain_value(value: Any) -> Any:
    """A value as JSON can hold it: times as ISO 8601, bytes as hexadecimal, NaN as text,
    a StatusCode by its name, a structure as an object of its fields.
    """
    if isinstance(value, list | tuple):
        elements: Sequence[Any] = value
        return [plain_value(element) for element in elements]
    if isinstance(value, dict):
        members: Mapping[str, Any] = value
        return {name: plain_value(member) for name, member in members.items()}
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, ua.LocalizedText):
        return value.Text
    if isinstance(value, ua.StatusCode):
        return value.name
    if isinstance(value, ua.NodeId):
        return value.to_string()
    if isinstance(value, ua.QualifiedName):
        return f"{value.NamespaceIndex}:{value.Name}"
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value) and not isinstance(value, type):  # a structure
        return {each.name: plain_value(getattr(value, each.name)) for each in fields(value)}
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return str(value)


def exact_value(value: Any) -> Any:
    """The same with nothing lost: bytes, times and all numbers stay what they are."""
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | int | float | str | bytes | datetime):
        return value
    if isinstance(value, list | tuple):
        elements: Sequence[Any] = value
        return [exact_value(element) for element in elements]
    if isinstance(value, dict):
        members: Mapping[str, Any] = value
        return {name: exact_value(member) for name, member in members.items()}
    if is_dataclass(value) and not isinstance(value, _NAMED | type):
        return {each.name: exact_value(getattr(value, each.name)) for each in fields(value)}
    return plain_value(value)
