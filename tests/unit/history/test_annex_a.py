"""The tables of OPC 10000-13 annex A: what each aggregate makes of the example historians."""

from __future__ import annotations

import pytest

from tests.unit.history.series import HISTORIANS, SETTINGS, at, lines, table
from ua_fleet.history.aggregates import Aggregate
from ua_fleet.history.processed import ProcessedPage, ProcessedRead, read_processed

FIVE, SIXTEEN = 5_000.0, 16_000.0
TABLES = {
    (Aggregate.INTERPOLATIVE, 1, FIVE): """
        0:00 NoData
        0:05 NoData
        0:10 10 Good
        0:15 15 Good Interpolated
        0:20 20 Good
        0:25 25 Good Interpolated
        0:30 30 Good
        0:35 35 SubNormal Interpolated
        0:40 40 SubNormal Interpolated
        0:45 45 SubNormal Interpolated
        0:50 50 Good
        0:55 55 Good Interpolated
        1:00 60 Good
        1:05 65 SubNormal Interpolated
        1:10 70 Uncertain
        1:15 75 SubNormal Interpolated
        1:20 80 Good
        1:25 85 Good Interpolated
        1:30 90 Good
        1:35 90 SubNormal Interpolated""",
    (Aggregate.INTERPOLATIVE, 2, FIVE): """
        0:00 NoData
        0:05 11.304 Good Interpolated
        0:10 13.478 Good Interpolated
        0:15 15.652 Good Interpolated
        0:20 17.826 Good Interpolated
        0:25 20 Good
        0:30 25.909 Good Interpolated
        0:35 28.182 Good Interpolated
        0:40 31.111 SubNormal Interpolated
        0:45 36.667 SubNormal Interpolated
        0:50 45 Good Interpolated
        0:55 51.5 Good Interpolated
        1:00 54 Good Interpolated
        1:05 56.5 Good Interpolated
        1:10 59 Good Interpolated
        1:15 62.727 SubNormal Interpolated
        1:20 67.273 SubNormal Interpolated
        1:25 76.667 Good Interpolated
        1:30 90 Good
        1:35 90 SubNormal Interpolated""",
    (Aggregate.INTERPOLATIVE, 3, FIVE): """
        0:00 NoData
        0:05 10 Good Interpolated
        0:10 10 Good Interpolated
        0:15 10 Good Interpolated
        0:20 10 Good Interpolated
        0:25 20 Good
        0:30 25 Good Interpolated
        0:35 25 Good Interpolated
        0:40 30 Good Interpolated
        0:45 30 SubNormal Interpolated
        0:50 40 Good Interpolated
        0:55 50 Good Interpolated
        1:00 50 Good Interpolated
        1:05 50 Good Interpolated
        1:10 50 Good Interpolated
        1:15 60 Good Interpolated
        1:20 60 SubNormal Interpolated
        1:25 70 Good Interpolated
        1:30 90 Good
        1:35 90 SubNormal Interpolated""",
    (Aggregate.AVERAGE, 1, FIVE): """
        0:00 NoData
        0:05 NoData
        0:10 10 Good Calculated
        0:15 NoData
        0:20 20 Good Calculated
        0:25 NoData
        0:30 30 Good Calculated
        0:35 NoData
        0:40 NoData
        0:45 NoData
        0:50 50 Good Calculated
        0:55 NoData
        1:00 60 Good Calculated
        1:05 NoData
        1:10 NoData
        1:15 NoData
        1:20 80 Good Calculated
        1:25 NoData
        1:30 90 Good Calculated
        1:35 NoData""",
    (Aggregate.AVERAGE, 2, FIVE): """
        0:00 10 Good Calculated
        0:05 NoData
        0:10 NoData
        0:15 NoData
        0:20 NoData
        0:25 22.5 Good Calculated
        0:30 NoData
        0:35 30 Good Calculated
        0:40 NoData
        0:45 40 Good Calculated
        0:50 50 Good Calculated
        0:55 NoData
        1:00 NoData
        1:05 NoData
        1:10 60 Good Calculated
        1:15 NoData
        1:20 70 Good Calculated
        1:25 80 Good Calculated
        1:30 90 Good Calculated
        1:35 NoData""",
    (Aggregate.TIME_AVERAGE, 1, FIVE): """
        0:00 NoData
        0:05 NoData
        0:10 12.5 Good Calculated
        0:15 17.5 Good Calculated
        0:20 22.5 Good Calculated
        0:25 27.5 Good Calculated
        0:30 32.5 SubNormal Calculated
        0:35 37.5 SubNormal Calculated
        0:40 42.5 SubNormal Calculated
        0:45 47.5 SubNormal Calculated
        0:50 52.5 Good Calculated
        0:55 57.5 Good Calculated
        1:00 62.5 SubNormal Calculated
        1:05 67.5 SubNormal Calculated
        1:10 72.5 SubNormal Calculated
        1:15 77.5 SubNormal Calculated
        1:20 82.5 Good Calculated
        1:25 87.5 Good Calculated
        1:30 90 SubNormal Calculated
        1:35 90 SubNormal Calculated""",
    (Aggregate.MINIMUM, 1, SIXTEEN): """
        0:00 10 Good Calculated Partial
        0:16 20 Good Calculated
        0:32 NoData
        0:48 50 Good Calculated
        1:04 NoData
        1:20 80 Good Partial
        1:36 NoData""",
    (Aggregate.MINIMUM, 2, SIXTEEN): """
        0:00 10 Good Calculated Partial
        0:16 20 Good Calculated
        0:32 30 SubNormal Calculated
        0:48 40 Good
        1:04 60 SubNormal Calculated
        1:20 70 Good Calculated Partial
        1:36 NoData""",
    (Aggregate.MAXIMUM, 1, SIXTEEN): """
        0:00 10 Good Calculated Partial
        0:16 30 Good Calculated
        0:32 NoData
        0:48 60 Good Calculated
        1:04 NoData
        1:20 90 Good Calculated Partial
        1:36 NoData""",
    (Aggregate.MAXIMUM, 2, SIXTEEN): """
        0:00 10 Good Calculated Partial
        0:16 25 Good Calculated
        0:32 30 SubNormal Calculated
        0:48 50 Good Calculated
        1:04 60 SubNormal Calculated
        1:20 90 Good Calculated Partial
        1:36 NoData""",
    (Aggregate.COUNT, 1, SIXTEEN): """
        0:00 1 Good Calculated Partial
        0:16 2 Good Calculated
        0:32 Bad Calculated
        0:48 2 Good Calculated
        1:04 0 SubNormal Calculated
        1:20 2 Good Calculated Partial
        1:36 NoData""",
    (Aggregate.COUNT, 2, SIXTEEN): """
        0:00 1 Good Calculated Partial
        0:16 2 Good Calculated
        0:32 1 SubNormal Calculated
        0:48 2 Good Calculated
        1:04 1 SubNormal Calculated
        1:20 3 Good Calculated Partial
        1:36 NoData""",
    (Aggregate.DURATION_GOOD, 1, SIXTEEN): """
        0:00 6000 Good Calculated Partial
        0:16 16000 Good Calculated
        0:32 0 Good Calculated
        0:48 14000 Good Calculated
        1:04 0 Good Calculated
        1:20 10001 Good Calculated Partial
        1:36 NoData""",
    **dict.fromkeys(
        [(Aggregate.DURATION_GOOD, number, SIXTEEN) for number in (2, 3, 4)],
        """
        0:00 14000 Good Calculated Partial
        0:16 16000 Good Calculated
        0:32 10000 Good Calculated
        0:48 16000 Good Calculated
        1:04 13000 Good Calculated
        1:20 7001 Good Calculated Partial
        1:36 NoData""",
    ),
    (Aggregate.PERCENT_GOOD, 1, SIXTEEN): """
        0:00 37.5 Good Calculated Partial
        0:16 100 Good Calculated
        0:32 0 Good Calculated
        0:48 87.5 Good Calculated
        1:04 0 Good Calculated
        1:20 100 Good Calculated Partial
        1:36 NoData""",
    **dict.fromkeys(
        [(Aggregate.PERCENT_GOOD, number, SIXTEEN) for number in (2, 3, 4)],
        """
        0:00 87.5 Good Calculated Partial
        0:16 100 Good Calculated
        0:32 62.5 Good Calculated
        0:48 100 Good Calculated
        1:04 81.25 Good Calculated
        1:20 70.003 Good Calculated Partial
        1:36 NoData""",
    ),
}
TABLES[Aggregate.AVERAGE, 3, FIVE] = TABLES[Aggregate.AVERAGE, 2, FIVE]
TABLES[Aggregate.MINIMUM, 3, SIXTEEN] = TABLES[Aggregate.MINIMUM, 2, SIXTEEN]
TABLES[Aggregate.MAXIMUM, 3, SIXTEEN] = TABLES[Aggregate.MAXIMUM, 2, SIXTEEN]


@pytest.mark.parametrize(("case", "expected"), TABLES.items(), ids=lambda case: str(case)[:40])
def test_a_table(case: tuple[Aggregate, int, float], expected: str) -> None:
    aggregate, number, interval_ms = case
    read = ProcessedRead(at("0:00"), at("1:40"), interval_ms, aggregate, SETTINGS[number])
    page = read_processed(HISTORIANS[number], read, 0, 100)
    assert isinstance(page, ProcessedPage)
    assert page.rest is None
    assert lines(page.rows) == table(expected)
