"""DateTime as text, lossless to 100 ns (OPC 10000-6 5.4.2.6, 5.1.4).

The second of a message's times is mostly the one of the message before, so the texts of seconds are kept, in both
directions.
"""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import orjson

from ua_fleet.errors import LocalWireError, RemoteWireError
from ua_fleet.values import TICKS_PER_SECOND
from ua_fleet.wire.json.causes import JsonCause, Leniency
from ua_fleet.wire.json.parsing import Reading, shown

__all__ = [
    "LATEST",
    "LATEST_TEXT",
    "NULL_TEXT",
    "TICKS",
    "TICKS_OF_BYTES",
    "decode_date",
    "decoding_names",
    "encode_date",
    "encoding_names",
    "lines_of_decoding",
    "lines_of_encoding",
    "usual_date",
]

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


# Formatting a number of seven digits takes as long as all else in writing a time.
FOUR_DIGITS: Final = [f"{number:04}" for number in range(10_000)]
THREE_DIGITS: Final = [f"{number:03}Z" for number in range(1_000)]

_TEN_MILLION: Final = 10_000_000

_MOST_SECONDS: Final = 1024
"""Of each direction that are kept."""
_TEXTS: Final[dict[int, str]] = {}
"""`YYYY-MM-DDTHH:MM:SS` by the seconds since 1601."""
TICKS: Final[dict[str, int]] = {}
"""Ticks by `YYYY-MM-DDTHH:MM:SS.`, only of times that are neither null nor the latest one."""
TICKS_OF_BYTES: Final[dict[bytes, int]] = {}
"""The same by the bytes of that text."""


def encode_date(ticks: Any) -> str:
    """The text of a DateTime; times before 1601 are null, those from 9999-12-31T23:59:59Z on are that."""
    if ticks.__class__ is not int or not -LATEST - 1 <= ticks <= LATEST:
        raise LocalWireError(f"{ticks!r:.80} is no DateTime")
    if not 0 < ticks < _FIRST_BEYOND:
        return LATEST_TEXT if ticks > 0 else NULL_TEXT
    second, fraction = divmod(ticks, TICKS_PER_SECOND)
    text = _TEXTS.get(second)
    if text is None:
        text = (_EPOCH + timedelta(seconds=second)).strftime("%Y-%m-%dT%H:%M:%S")
        _keep(_TEXTS, second, text)
    return f"{text}.{fraction:07}Z" if fraction else text + "Z"


def second_of(ticks: int) -> tuple[float, str]:
    """The first tick of a time's second, and `YYYY-MM-DDTHH:MM:SS.`.

    A null time, the latest one and those of the first second of 1601 have none: no number of ticks is near infinity.
    """
    if not TICKS_PER_SECOND <= ticks < _FIRST_BEYOND:
        return math.inf, ""
    first = ticks - ticks % TICKS_PER_SECOND
    return first, encode_date(first)[:-1] + "."


def lines_of_encoding(ticks: str, text: str, known: str) -> list[str]:
    """Code that makes `text` of the variable `ticks`, as `encode_date`, and remembers the second of the last time.

    It has the names of `encoding_names(known)` at hand. Raises TypeError for what is no integer.
    """
    return [
        f"global {known}_first, {known}_text",
        f"if {ticks}.__class__ is not int: raise TypeError",
        f"fraction = {ticks} - {known}_first",
        f"if 0 < fraction < {TICKS_PER_SECOND}:",
        f" {text} = f'{{{known}_text}}{{FOUR_DIGITS[fraction // 1000]}}{{THREE_DIGITS[fraction % 1000]}}'",
        f"elif not fraction: {text} = {known}_text[:-1] + 'Z'",
        "else:",
        f" {known}_first, {known}_text = second_of({ticks})",
        f" {text} = encode_date({ticks})",
    ]


def encoding_names(known: str) -> dict[str, Any]:
    """What `lines_of_encoding` refer to."""
    first, text = second_of(0)
    names: dict[str, Any] = {f"{known}_first": first, f"{known}_text": text}
    return names | {
        "FOUR_DIGITS": FOUR_DIGITS,
        "THREE_DIGITS": THREE_DIGITS,
        "encode_date": encode_date,
        "second_of": second_of,
    }


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


def lines_of_decoding(text: str, known: str) -> list[str]:
    """Code that makes the ticks of the variable `text`, as `usual_date`, and remembers the second of the last time.

    It has the names of `decoding_names(known)` at hand. Raises TypeError or ValueError for what is no text of a usual
    form.
    """
    return [
        f"global {known}_first, {known}_text",
        f"if {text}[:20] == {known}_text and {text}[27:] == 'Z':",
        # It is seven digits if it makes a number of eight, the first of which is 1, and no other number than one.
        f" fraction = loads('1' + {text}[20:27])",
        f" if fraction.__class__ is not int or fraction < {_TEN_MILLION}: raise ValueError",
        f" {text} = {known}_first + fraction",
        "else:",
        f" {known}_text, {text} = {text}[:20], usual_date({text})",
        f" {known}_first = TICKS.get({known}_text, 0) - {_TEN_MILLION}",
        f" if {known}_first < 0: {known}_text = ''",
    ]


def decoding_names(known: str) -> dict[str, Any]:
    """What `lines_of_decoding` refer to."""
    names: dict[str, Any] = {f"{known}_first": 0, f"{known}_text": ""}
    return names | {"loads": orjson.loads, "TICKS": TICKS, "usual_date": usual_date}


def _keep(seconds: dict[Any, Any], key: Any, value: Any) -> None:
    if len(seconds) >= _MOST_SECONDS:
        seconds.clear()
    seconds[key] = value


def _ticks_of(text: str) -> int:
    """The ticks of `YYYY-MM-DDTHH:MM:SS`; raises ValueError."""
    ticks = TICKS.get(text + ".")
    if ticks is not None:
        return ticks
    if text[7::3] != "-T::" or text[4] != "-":  # `fromisoformat` reads more: weeks, times without colons, zones
        raise ValueError(text)
    delta = datetime.fromisoformat(text).replace(tzinfo=UTC) - _EPOCH
    ticks = (delta.days * 86_400 + delta.seconds) * TICKS_PER_SECOND
    if TICKS_PER_SECOND <= ticks < _FIRST_BEYOND:
        _keep(TICKS, text + ".", ticks)
        _keep(TICKS_OF_BYTES, (text + ".").encode(), ticks)
    return ticks


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
