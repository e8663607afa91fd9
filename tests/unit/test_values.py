from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.values import (
    UNIX_EPOCH_TICKS,
    Quality,
    StatusCode,
    datetime_from_ticks,
    quality_of,
    status_name,
    ticks_from_datetime,
    ticks_from_unix_ns,
    unix_ns_from_ticks,
)

FIRST, LAST = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)


@pytest.mark.parametrize(
    ("moment", "ticks"),
    [
        (datetime(1601, 1, 1, tzinfo=UTC), 0),
        (datetime(1970, 1, 1, tzinfo=UTC), UNIX_EPOCH_TICKS),
        (datetime(2000, 1, 1, tzinfo=UTC), 125_911_584_000_000_000),
        (datetime(1601, 1, 1, 0, 0, 0, 1, tzinfo=UTC), 10),
        (datetime(1970, 1, 1, 1, tzinfo=timezone(timedelta(hours=1))), UNIX_EPOCH_TICKS),
        (datetime(1600, 12, 31, 23, 59, 59, tzinfo=UTC), -10_000_000),
    ],
)
def test_ticks_of_known_moments(moment: datetime, ticks: int) -> None:
    assert ticks_from_datetime(moment) == ticks
    assert datetime_from_ticks(ticks) == moment


@given(st.datetimes(timezones=st.just(UTC)))
def test_every_datetime_comes_back_from_its_ticks(moment: datetime) -> None:
    assert datetime_from_ticks(ticks_from_datetime(moment)) == moment


@given(st.integers(-(2**63), 2**63 - 1))
def test_every_number_of_ticks_has_a_datetime(ticks: int) -> None:
    moment = datetime_from_ticks(ticks)
    if moment not in (LAST, FIRST):
        assert 0 <= ticks - ticks_from_datetime(moment) < 10


@pytest.mark.parametrize(("ticks", "end"), [(2**63 - 1, LAST), (-(2**63), FIRST)])
def test_times_that_python_does_not_know_are_cut(ticks: int, end: datetime) -> None:
    assert datetime_from_ticks(ticks) == end


@given(st.integers(-(2**62), 2**62))
def test_unix_time_loses_less_than_a_tick(unix_ns: int) -> None:
    assert 0 <= unix_ns - unix_ns_from_ticks(ticks_from_unix_ns(unix_ns)) < 100


@given(st.integers(0, 2**63 - 1))
def test_ticks_come_back_from_unix_time(ticks: int) -> None:
    assert ticks_from_unix_ns(unix_ns_from_ticks(ticks)) == ticks


@pytest.mark.parametrize(
    ("status", "quality"),
    [
        (StatusCode.GOOD, Quality.GOOD),
        (0x00A6_0000, Quality.GOOD),
        (StatusCode.UNCERTAIN_LAST_USABLE_VALUE, Quality.UNCERTAIN),
        (StatusCode.BAD_NO_COMMUNICATION, Quality.BAD),
        (0xC000_0000, Quality.BAD),
        (0xFFFF_FFFF, Quality.BAD),
    ],
)
def test_quality_is_the_severity(status: int, quality: Quality) -> None:
    assert quality_of(status) is quality


@pytest.mark.parametrize(
    ("status", "name"),
    [
        (StatusCode.GOOD, "Good"),
        (StatusCode.BAD_NO_COMMUNICATION, "BadNoCommunication"),
        (StatusCode.BAD_NO_COMMUNICATION | 0x0480, "BadNoCommunication"),
        (0x80FE_0001, "0x80FE0001"),
    ],
)
def test_name_of_a_status(status: int, name: str) -> None:
    assert status_name(status) == name


def test_status_codes_are_those_of_the_specification() -> None:
    ua = pytest.importorskip("asyncua.ua")
    names = {"".join(part.capitalize() for part in code.name.split("_")): code for code in StatusCode}
    foreign = {name: int(getattr(ua.StatusCodes, name)) for name in names if hasattr(ua.StatusCodes, name)}
    assert {name: int(code) for name, code in names.items() if name in foreign} == foreign
    assert set(names) - set(foreign) <= {"Good", "Uncertain", "Bad"}
