"""How far a server's clock is ahead."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

from ua_fleet.console.server_clock import ServerClock

NOW = datetime(2030, 1, 1, tzinfo=UTC)


def after(seconds: float) -> datetime:
    return NOW + timedelta(seconds=seconds)


def test_a_time_that_is_renewed_once_a_second_is_no_difference() -> None:
    clock = ServerClock()
    told = [clock.take(after(number), after(number + number % 10 / 10)) for number in range(40)]
    assert not any(told[10:])
    assert clock.ahead_s == 0


def test_a_clock_that_is_ahead_is_told_once_and_again_where_it_was_set() -> None:
    clock = ServerClock()
    assert clock.take(after(3600), NOW)
    assert clock.ahead_s == 3600
    assert not clock.take(after(3601), after(1.9))
    assert not clock.take((after(3602)).replace(tzinfo=None), after(2)), "without a zone it is UTC"
    told = [clock.take(after(number - 60), after(number)) for number in range(3, 20)]
    assert told.count(True) == 1
    assert clock.ahead_s == -60


def test_what_is_no_time_says_nothing() -> None:
    clock = ServerClock()
    assert not clock.take(None, NOW)
    assert clock.ahead_s == 0
