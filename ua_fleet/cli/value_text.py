"""Values, their quality and their times as a person reads them. Pure."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, tzinfo
from typing import Any, Final, cast

__all__ = ["ValueStyle", "age_text", "clock_text", "duration_text", "moment_text", "status_words", "value_text"]

LONGEST_TEXT: Final = 200
"""Characters of a text that is not cut."""
LONGEST_BYTES: Final = 32
LONGEST_ARRAY: Final = 10
_SHOWN: Final = 8
"""Elements, or bytes times two, of what is cut."""
_GOOD: Final = 0
_OVERFLOW: Final = 0x480
"""InfoType DataValue with the Overflow bit (OPC 10000-4 7.39.1)."""
_NO_TIME: Final = datetime(1601, 1, 1, tzinfo=UTC)
"""DateTime without a value (OPC 10000-6 5.2.2.5)."""
_SECONDS: Final = (("d", 86_400), ("h", 3_600), ("min", 60))


@dataclass(frozen=True, slots=True)
class ValueStyle:
    """How values of one Variable are shown."""

    unit: str = ""
    names: Mapping[int, str] = field(default_factory=dict[int, str])
    """Of the values of an enumeration."""
    is_full: bool = False
    """Whether long ones are shown whole."""
    zone: tzinfo | None = None
    """For times; None is local time."""


def value_text(value: Any, type_name: str | None, style: ValueStyle | None = None) -> str:
    """A value with its unit; what is long is cut, and its size said. `-` is no value at all.

    Args:
        value: as a Reading has it: bytes in hexadecimal, times in ISO 8601, structures as objects.
        type_name: name of its built-in type.
        style: how it is shown.
    """
    style = style or ValueStyle()
    if value is None:
        return "-"
    text = _shown(value, type_name, style)
    if isinstance(value, int) and not isinstance(value, bool) and value in style.names:
        text = f"{text} ({style.names[value]})"
    return f"{text} {style.unit}" if style.unit else text


def _shown(value: Any, type_name: str | None, style: ValueStyle) -> str:
    if isinstance(value, list):
        elements = cast("Sequence[Any]", value)
        is_cut = not style.is_full and len(elements) > LONGEST_ARRAY
        shown = [_shown(each, type_name, style) for each in (elements[:_SHOWN] if is_cut else elements)]
        return f"[{', '.join(shown)}, … {len(elements):,} elements]" if is_cut else f"[{', '.join(shown)}]"
    if isinstance(value, Mapping):
        members = cast("Mapping[str, Any]", value)
        return "{" + ", ".join(f"{name}: {_shown(each, None, style)}" for name, each in members.items()) + "}"
    if isinstance(value, str):
        return _text(value, type_name, style)
    if isinstance(value, float) and type_name == "Float":
        return _single(value)
    return json.dumps(value, ensure_ascii=False)


def _text(value: str, type_name: str | None, style: ValueStyle) -> str:
    if type_name == "ByteString":
        size = len(value) // 2
        return value if style.is_full or size <= LONGEST_BYTES else f"{value[: 2 * _SHOWN]}… {size:,} bytes"
    if type_name == "DateTime":
        try:
            moment = datetime.fromisoformat(value)
            return "null" if moment == _NO_TIME else moment_text(moment, style.zone)
        except ValueError:
            return value
    if style.is_full or len(value) <= LONGEST_TEXT:
        return json.dumps(value, ensure_ascii=False)
    return f"{json.dumps(value[:LONGEST_TEXT], ensure_ascii=False)}… {len(value):,} characters"


def _single(value: float) -> str:
    """A number of 32 bits with as many digits as tell it from its neighbours."""
    for digits in range(6, 9):
        text = float(f"{value:.{digits}g}")
        if struct.pack("f", text) == struct.pack("f", value):
            return json.dumps(text)
    return json.dumps(value)


def status_words(status: int, name: str) -> str:
    """What is to be said of a StatusCode; nothing of one that is Good without more."""
    lost = "values were lost in the server's queue" if status & _OVERFLOW == _OVERFLOW else ""
    if status >> 30 == _GOOD and not lost:
        return "" if status == 0 or name == "Good" else name
    return f"{name} ({lost})" if lost else name


def moment_text(moment: datetime, zone: tzinfo | None) -> str:
    """A time to the millisecond with its distance from UTC; without a zone the local one."""
    return _in_zone(moment, zone).isoformat(sep=" ", timespec="milliseconds")


def _in_zone(moment: datetime, zone: tzinfo | None) -> datetime:
    """A time in a zone; as it is, where the first or the last time there is would be another one in that zone."""
    try:
        return moment.astimezone(zone)
    except (OverflowError, ValueError):
        return moment


def clock_text(moment: datetime | None, now: datetime, zone: tzinfo | None) -> str:
    """A time without its day, where that is today's; `-` where there is none."""
    if moment is None:
        return "-"
    local = _in_zone(moment, zone)
    is_today = local.date() == now.astimezone(zone).date()
    return local.time().isoformat(timespec="milliseconds") if is_today else moment_text(moment, zone)


def duration_text(seconds: float) -> str:
    """A duration in its two largest units, e.g. `2 h 5 min`; below a minute `12.5 s`."""
    if abs(seconds) < _SECONDS[-1][1]:
        return f"{seconds:.1f} s"
    sign, left = ("-", round(-seconds)) if seconds < 0 else ("", round(seconds))
    parts: list[str] = []
    for unit, size in (*_SECONDS, ("s", 1)):
        number, left = divmod(left, size)
        if number or parts:
            parts.append(f"{number} {unit}" if number else "")
        if len(parts) == 2:
            break
    return sign + " ".join(filter(None, parts))


def age_text(moment: datetime | None, now: datetime) -> str:
    """How old something is; `-` where it has no time."""
    return "-" if moment is None else duration_text((now - moment).total_seconds())
