"""Values as JSON for the page; docs/console.md describes the form, `web/src/lib/value.ts` reads it.

What JSON cannot hold is an object with one key of ours: `{"int": "9223372036854775807"}` for whole numbers that a
browser would round, `{"float": "NaN"}`, `{"bytes": 12, "base64": "..."}`, `{"array": 100000, "first": [...]}`.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final, cast

from ua_fleet.client import Reading
from ua_fleet.printing import harmless

__all__ = ["harmless_value", "shown_instant", "shown_moment", "shown_reading", "shown_time", "shown_value"]

_EXACT: Final = 2**53
"""Whole numbers up to here are exact in a browser (Number.MAX_SAFE_INTEGER + 1)."""
_SHORT: Final = 1024
"""A ByteString up to this many bytes is shown itself."""
_ELEMENTS: Final = 1000
"""An array up to this many elements is shown whole."""
_CHARACTERS: Final = 16_384
"""A text up to this many characters is shown whole."""
_DEPTH: Final = 16
_FIRST_YEAR: Final = 1970
"""A DateTime before is the one that stands for none."""


def shown_reading(reading: Reading, unit: str = "") -> dict[str, Any]:
    """A Variable's value with its status, time, and unit."""
    shown: dict[str, Any] = {
        "v": shown_value(reading.exact),
        "s": reading.status,
        "t": shown_time(reading.source_time),
    }
    if unit:
        shown["u"] = harmless(unit)
    return shown


def shown_time(moment: datetime | None) -> str | None:
    """A time as ISO 8601 in UTC, to the millisecond."""
    if moment is None:
        return None
    aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    return aware.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def shown_moment(moment: datetime | None) -> str | None:
    """A DateTime that a server tells, likewise; None for its null, which is one of 1601 in an array."""
    return None if moment is None or moment.year < _FIRST_YEAR else shown_time(moment)


def shown_instant(seconds: float) -> str | None:
    """A time in seconds since 1970 likewise."""
    return shown_time(datetime.fromtimestamp(seconds, UTC))


def shown_value(value: Any, depth: int = 0) -> Any:
    """A value as JSON can hold it."""
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, int):
        return value if -_EXACT < value < _EXACT else {"int": str(value)}
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": _NOT_FINITE.get(value, "NaN")}
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, datetime):
        return shown_time(value)
    if isinstance(value, bytes):
        if len(value) > _SHORT:
            return {"bytes": len(value)}
        return {"bytes": len(value), "base64": base64.b64encode(value).decode("ascii")}
    if depth >= _DEPTH:
        return {"deep": type(value).__name__}
    if isinstance(value, Mapping):
        fields: Mapping[Any, Any] = value  # pyright: ignore[reportUnknownVariableType]
        return {_sound(str(name)): shown_value(part, depth + 1) for name, part in fields.items()}
    if isinstance(value, Sequence):
        elements: Sequence[Any] = value  # pyright: ignore[reportUnknownVariableType]
        shown = [shown_value(element, depth + 1) for element in elements[:_ELEMENTS]]
        return shown if len(elements) <= _ELEMENTS else {"array": len(elements), "first": shown}
    return _text(str(value))


_NOT_FINITE: Final = {math.inf: "Infinity", -math.inf: "-Infinity"}


def _text(text: str) -> Any:
    sound = _sound(text)
    return sound if len(sound) <= _CHARACTERS else {"text": len(sound), "first": sound[:_CHARACTERS]}


def _sound(text: str) -> str:
    """Without lone surrogates: they are no UTF-8, and would end the WebSocket."""
    return text if text.isascii() else text.encode("utf-8", "replace").decode("utf-8")


def harmless_value(value: Any) -> Any:
    """The same object with all its texts made harmless: for names and messages."""
    if isinstance(value, str):
        return harmless(value)
    if isinstance(value, Mapping):
        fields = cast("Mapping[str, Any]", value)
        return {harmless(str(name)): harmless_value(part) for name, part in fields.items()}
    if isinstance(value, list | tuple):
        elements = cast("Sequence[Any]", value)
        return [harmless_value(element) for element in elements]
    return value
