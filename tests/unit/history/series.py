"""The historians of OPC 10000-13 annex A.1, and how its tables are written here."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any, Final

from ua_fleet.history.bounds import Settings
from ua_fleet.history.rows import BAD_NO_DATA, HistoryBits, ListSeries, Row, Rows
from ua_fleet.values import TICKS_PER_SECOND, BuiltinType, ticks_from_datetime

NOON: Final = ticks_from_datetime(datetime(2026, 3, 1, 12, tzinfo=UTC))
GOOD, UNCERTAIN, BAD = 0, 0x4000_0000, 0x8000_0000
DOUBLE, BOOLEAN = int(BuiltinType.DOUBLE), int(BuiltinType.BOOLEAN)
_STATUSES: Final = {0: "Good", 0x4000: "Uncertain", 0x40A4: "SubNormal", 0x8000: "Bad", 0x809B: "NoData"}


def at(text: str) -> int:
    """`12:01:30.5`, or `1:30` for short, as ticks."""
    parts = [float(part) for part in text.split(":")]
    hours, minutes, seconds = ([12.0] * (3 - len(parts)) + parts)[-3:]
    return NOON + round(((hours - 12) * 3600 + minutes * 60 + seconds) * TICKS_PER_SECOND)


def rows(*given: tuple[str, Any, int], kind: int = DOUBLE) -> list[Row]:
    return [Row(at(time), status, 0 if value is None else kind, value) for time, value, status in given]


_FIRST: Final = ("0:00", None, BAD_NO_DATA)
HISTORIAN_1: Final = ListSeries(
    rows(
        _FIRST,
        *((f"{at // 60}:{at % 60:02}", float(at), GOOD) for at in (10, 20, 30, 50, 60, 80, 90)),
        ("0:40", 40.0, BAD),
        ("1:10", 70.0, UNCERTAIN),
    )
)
_TIMES: Final = ("0:02", "0:25", "0:28", "0:39", "0:42", "0:48", "0:52", "1:12", "1:17", "1:23", "1:26", "1:30")
_STATUS: Final = (GOOD, GOOD, GOOD, GOOD, BAD, GOOD, GOOD, GOOD, UNCERTAIN, GOOD, GOOD, GOOD)
_VALUES: Final = (10.0, 20.0, 25.0, 30.0, None, 40.0, 50.0, 60.0, 70.0, 70.0, 80.0, 90.0)
HISTORIAN_2: Final = ListSeries(rows(_FIRST, *zip(_TIMES, _VALUES, _STATUS, strict=True)))
HISTORIAN_3: Final = HISTORIAN_2
_FLAGS: Final = (True, False, True, True, None, True, False, False, True, True, False, True)
HISTORIAN_4: Final = ListSeries(rows(_FIRST, *zip(_TIMES, _FLAGS, _STATUS, strict=True), kind=BOOLEAN))


class FewBytes(ListSeries):
    """Rows of which few bytes are read at once."""

    def between(self, first: int, last: int, most: int, *, backward: bool = False, most_bytes: int = 100) -> Rows:
        """As the protocol says."""
        return super().between(first, last, most, backward=backward, most_bytes=min(100, most_bytes))


SETTINGS: Final = {
    1: Settings(treat_uncertain_as_bad=False),
    2: Settings(treat_uncertain_as_bad=True),
    3: Settings(stepped=True, percent_data_bad=50, percent_data_good=50),
    4: Settings(stepped=True),
}
HISTORIANS: Final = {1: HISTORIAN_1, 2: HISTORIAN_2, 3: HISTORIAN_3, 4: HISTORIAN_4}


def told(row: Row) -> str:
    """A row as a line of a table: `1:20 70.003 Good Calculated Partial`."""
    seconds = (row.time - NOON) / TICKS_PER_SECOND
    value = "" if row.value is None else f"{round(float(row.value), 3):g} "
    bits = HistoryBits(row.status & 0x1F)
    names = [bit.name.title().replace("_", "") for bit in HistoryBits if bit & bits and bit.name]
    assert (row.status & 0x0400 != 0) == bool(bits), hex(row.status)
    return f"{int(seconds // 60)}:{seconds % 60:02g} {value}{' '.join([_STATUSES[row.status >> 16], *names])}"


def table(text: str) -> list[str]:
    return [line.strip() for line in text.strip().splitlines()]


def lines(found: Iterable[Row]) -> list[str]:
    return [told(row) for row in found]
