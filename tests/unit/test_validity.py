from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from ua_fleet.validity import Reminder, Validity

BEGIN = datetime(2030, 1, 1, 12, tzinfo=UTC)
END = datetime(2030, 12, 31, 12, tzinfo=UTC)
VALIDITY = Validity(BEGIN, END)


@pytest.mark.parametrize(
    ("now", "days", "problem", "notice"),
    [
        (BEGIN - timedelta(hours=1), 364, "is valid only from 2030-01-01 12:00 UTC", ""),
        (BEGIN, 364, "", ""),
        (END - timedelta(days=30), 30, "", ""),
        (END - timedelta(days=30, seconds=-1), 29, "", "expires on 2030-12-31, in 29 days"),
        (END - timedelta(days=1), 1, "", "expires on 2030-12-31, in 1 day"),
        (END, 0, "", "expires on 2030-12-31, in 0 days"),
        (END + timedelta(seconds=1), -1, "expired on 2030-12-31", ""),
    ],
)
def test_what_there_is_to_say(now: datetime, days: int, problem: str, notice: str) -> None:
    assert VALIDITY.days_left(now) == days
    assert VALIDITY.problem(now) == problem
    assert VALIDITY.notice(now) == notice or problem


def test_it_is_said_once_a_day_and_when_it_changes() -> None:
    reminder, now = Reminder(), END - timedelta(days=1, hours=1)
    assert reminder.due("a", VALIDITY, END - timedelta(days=40)) == ""
    assert reminder.due("a", VALIDITY, now) == "expires on 2030-12-31, in 1 day"
    assert reminder.due("a", VALIDITY, now + timedelta(hours=23)) == ""
    assert reminder.due("b", VALIDITY, now + timedelta(hours=23)).startswith("expires")
    assert reminder.due("a", VALIDITY, now + timedelta(hours=24)) == "expires on 2030-12-31, in 0 days"
    assert reminder.due("a", VALIDITY, END + timedelta(minutes=1)) == "expired on 2030-12-31"
    assert reminder.due("a", VALIDITY, END + timedelta(hours=23)) == ""
    assert reminder.due("a", VALIDITY, END + timedelta(hours=25)) == "expired on 2030-12-31"
    assert reminder.due("a", Validity(BEGIN, END + timedelta(days=900)), END + timedelta(hours=26)) == ""
    assert reminder.due("a", VALIDITY, END + timedelta(hours=27)) == "expired on 2030-12-31"
