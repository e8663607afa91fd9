"""DateTime as text, lossless to 100 ns (OPC 10000-6 5.4.2.6, 5.1.4).

The second of a message's times is mostly the one of the message before, so the texts of seconds are kept.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from typing import Any, Final

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.parsing import Reading, shown

__all__ = ["LATEST", "LATEST_TEXT", "NULL_TEXT", "decode_date", "encode_date", "usual_date"]

NULL_TEXT: Final = "0001-01-01T00:00:00Z"
"""DateTime.MinValue, and what is before 1601."""
LATEST_TEXT: Final = "9999-12-31T23:59:59Z"
LATEST: Final = 0x7FFF_FFFF_FFFF_FFFF
"""The DateTime that stands for all times from LATEST_TEXT on (OPC 10000-6 5.1.4)."""
_FIRST_BEYOND: Final = 2_650_467_743_990_000_000
"""Ticks of 9999-12-31T23:59:59Z."""

_EPOCH: Final = datetime(1601, 1, 1, tzinfo=UTC)
_FORM: Final = re.compile(
    r"(\d{4}-\d\d-\d\d)([Tt ])(\d\d:\d\d:\d\d)(?:[.,](\d{1,30}))?([Zz]|[+-]\d\d:?\d\d)?", re.ASCII
)


@lru_cache(maxsize=1024)
def _text_of(second: int) -> str:
    return (_EPOCH + timedelta(seconds=second)).strftime("%Y-%m-%dT%H:%M:%S")


@lru_cache(maxsize=1024)
def _ticks_of(text: str) -> int:
    """The ticks of `YYYY-MM-DDTHH:MM:SS`; raises ValueError."""
    if text[10] != "T":
        raise ValueError(text)
    delta = datetime.fromisoformat(text).replace(tzinfo=UTC) - _EPOCH
    return (delta.days * 86_400 + delta.seconds) * TICKS_PER_SECOND


def encode_date(ticks: Any) -> str:
    """The text of a DateTime; times before 1601 are null, those from 9999-12-31T23:59:59Z on are that."""
    if ticks.__class__ is not int or not -LATEST - 1 <= ticks <= LATEST:
        raise LocalWireError(f"{ticks!r:.80} is no DateTime")
    if 0 < ticks < _FIRST_BEYOND:
        second, fraction = divmod(ticks, TICKS_PER_SECOND)
        return f"{_text_of(second)}.{fraction:07}Z" if fraction else _text_of(second) + "Z"
    return LATEST_TEXT if ticks > 0 else NULL_TEXT


def usual_date(value: str) -> int:
    """The ticks of a DateTime in one of the two forms that we write; raises ValueError for any other."""
    size = len(value)
    if size == 28:
        fraction = value[20:27]
        if value[27] != "Z" or value[19] != "." or not fraction.isascii() or not fraction.isdigit():
            raise ValueError(value)
        ticks = _ticks_of(value[:19]) + int(fraction)
    elif size == 20 and value[19] == "Z":
        ticks = _ticks_of(value[:19])
    else:
        raise ValueError(value)
    return ticks if 0 < ticks < _FIRST_BEYOND else _within(ticks)


def decode_date(reading: Reading, value: Any) -> int:
    """The ticks of a DateTime; null is 0. Digits beyond 100 ns are cut off."""
    if value.__class__ is str:
        try:
            return usual_date(value)
        except ValueError:
            return _decode_form(reading, value)
    if value is None:
        return 0
    raise RemoteWireError(JsonCause.VALUE_TYPE, f"{shown(value)} is no DateTime")


def _within(ticks: int) -> int:
    return (ticks if ticks < _FIRST_BEYOND else LATEST) if ticks > 0 else 0


def _decode_form(reading: Reading, value: str) -> int:
    match = _FORM.fullmatch(value)
    if match is None:
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no DateTime")
    day, between, clock, fraction, zone = match.groups()
    leap = clock.endswith(":60")  # a leap second is the last one before it
    try:
        ticks = _ticks_of(f"{day}T{clock[:-2]}59" if leap else f"{day}T{clock}")
    except ValueError:
        raise RemoteWireError(JsonCause.VALUE_TEXT, f"{shown(value)} is no DateTime") from None
    ticks += int((fraction or "")[:7].ljust(7, "0"))
    if between != "T" or zone != "Z" or leap:
        reading.note(Leniency.DATE_FORM)
    if zone and zone not in "Zz":
        minutes = int(zone[1:3]) * 60 + int(zone[-2:])
        ticks -= (minutes if zone[0] == "+" else -minutes) * 60 * TICKS_PER_SECOND
    return _within(ticks)
