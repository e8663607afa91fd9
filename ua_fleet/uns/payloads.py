"""How a value looks in a Unified Namespace.

    VALUE      21.5                                                              and null while it is not Good
    OBJECT     {"value":21.5,"time":"2024-01-17T21:20:00Z","quality":"Good"}     and a null value while it is Bad

A bare value says nothing of its quality, so nothing but a Good one is written. Beside a quality an Uncertain value
stays, since it is the last usable one; a Bad one does not, for a reader that takes the value and leaves the rest.

An empty message clears the topic: there is no such value any more. So null and nothing are told apart.
"""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any, Final

from ua_fleet.errors import LocalWireError
from ua_fleet.values import ARRAY, DIMENSIONS, BuiltinType, Quality, quality_of, status_name
from ua_fleet.wire.json.dates import encode_date
from ua_fleet.wire.json.parsing import dump
from ua_fleet.wire.json.scalars import FLOAT

__all__ = ["CLEARED", "Payload", "encode_payload", "quality_name"]

CLEARED: Final = b""
"""Has the broker retain nothing any more."""
_INTEGERS: Final = (
    BuiltinType.SBYTE,
    BuiltinType.BYTE,
    BuiltinType.INT16,
    BuiltinType.UINT16,
    BuiltinType.INT32,
    BuiltinType.UINT32,
    BuiltinType.INT64,
    BuiltinType.UINT64,
)
_FLOAT_DIGITS: Final = (6, 7, 8, 9)
"""The last tells each two numbers of 32 bits apart."""


class Payload(StrEnum):
    """What stands on a topic."""

    VALUE = "value"
    OBJECT = "object"


def encode_payload(form: Payload, type_code: int, value: Any, status: int, ticks: int | None) -> bytes:
    """What a topic gets for a value.

    Args:
        form: of all topics.
        type_code: of the value; 0 where there is none.
        value: it.
        status: its StatusCode.
        ticks: its time.

    Raises:
        LocalWireError: JSON has nothing for such a value.
    """
    quality = quality_of(status)
    is_shown = quality is Quality.GOOD if form is Payload.VALUE else quality is not Quality.BAD
    try:
        shown = _plain(type_code, value) if is_shown else None
    except (AttributeError, TypeError, ValueError, OverflowError) as error:  # one value, and not all that is due
        raise LocalWireError(f"a value that is none of type code {type_code:#x}: {error!s:.100}") from None
    if form is Payload.OBJECT:
        shown = {
            "value": shown,
            "time": None if ticks is None else encode_date(ticks),
            "quality": quality_name(status),
        }
    return dump(shown)


def quality_name(status: int) -> str:
    """The name of a StatusCode, which begins with Good, Uncertain or Bad also where we have no name for it."""
    name = status_name(status)
    return quality_of(status).name.capitalize() + name if name.startswith("0x") else name


def _plain(type_code: int, value: Any) -> Any:
    """What `orjson` writes; NaN and the infinities become null there, since JSON has neither."""
    if value is None or not type_code:
        return None
    encode = _ENCODERS.get(type_code & ~(ARRAY | DIMENSIONS))
    if encode is None:
        raise LocalWireError(f"a value of type code {type_code:#x} has no plain form")
    if type_code & DIMENSIONS:
        return _rows([encode(each) for each in value.values], value.dimensions)
    return [encode(each) for each in value] if type_code & ARRAY else encode(value)


def _rows(values: list[Any], dimensions: Sequence[int]) -> list[Any]:
    """The elements of a matrix as arrays in each other."""
    first, *inner = dimensions
    if not inner:
        return values
    size = math.prod(inner)
    return [_rows(values[size * row : size * (row + 1)], inner) for row in range(first)]


def _as_it_is(value: Any) -> Any:
    return value


def _float(value: float) -> float:
    """The shortest number that is this one in 32 bits: 0.1, and not 0.10000000149011612."""
    if not math.isfinite(value):
        return value
    try:
        (exact,) = FLOAT.unpack(FLOAT.pack(value))
    except OverflowError:
        raise LocalWireError(f"{value!r} is no Float") from None
    texts = (f"{exact:.{digits}g}" for digits in _FLOAT_DIGITS)
    return next(number for number in map(float, texts) if FLOAT.pack(number) == FLOAT.pack(exact))


def _bytes(value: Any) -> str | None:
    return None if value is None else b64encode(value).decode()


_ENCODERS: Final[dict[int, Callable[[Any], Any]]] = {
    BuiltinType.BOOLEAN: bool,
    **dict.fromkeys(_INTEGERS, int),
    BuiltinType.FLOAT: _float,
    BuiltinType.DOUBLE: float,
    BuiltinType.STRING: _as_it_is,
    BuiltinType.DATETIME: encode_date,
    BuiltinType.GUID: str,
    BuiltinType.BYTE_STRING: _bytes,
}
"""The types that data of robots may have."""
