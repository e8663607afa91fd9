"""Values, qualities and times as a person reads them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import pytest

from ua_fleet.cli.value_text import (
    ValueStyle,
    age_text,
    clock_text,
    duration_text,
    moment_text,
    status_words,
    value_text,
)

NOON = datetime(2030, 1, 31, 12, tzinfo=UTC)
PARIS = timezone(timedelta(hours=1))


@pytest.mark.parametrize(
    ("value", "type_name", "text"),
    [
        (None, "Null", "-"),
        (True, "Boolean", "true"),
        (7, "Int32", "7"),
        (0.1, "Double", "0.1"),
        (0.10000000149011612, "Float", "0.1"),
        (16777217.0, "Double", "16777217.0"),
        ("a b", "String", '"a b"'),
        ([1, 2], "Int32", "[1, 2]"),
        ([], "String", "[]"),
        (["a"], "String", '["a"]'),
        ([[1, 2], [3, 4]], "Int32", "[[1, 2], [3, 4]]"),
        ({"Low": 0.0, "High": 1.0}, "ExtensionObject", "{Low: 0.0, High: 1.0}"),
        ("0a0b", "ByteString", "0a0b"),
        ("no time", "DateTime", "no time"),
        ("1601-01-01T00:00:00+00:00", "DateTime", "null"),
    ],
)
def test_values(value: Any, type_name: str, text: str) -> None:
    assert value_text(value, type_name) == text


@pytest.mark.parametrize(
    ("value", "type_name", "text", "length"),
    [
        ("ab" * 921_600, "ByteString", "abababababababab… 921,600 bytes", 1_843_200),
        (list(range(1000)), "Int32", "[0, 1, 2, 3, 4, 5, 6, 7, … 1,000 elements]", 4890),
        ("x" * 5000, "String", f'"{"x" * 200}"… 5,000 characters', 5002),
        (["x" * 300], "String", f'["{"x" * 200}"… 300 characters]', 304),
    ],
)
def test_what_is_long_is_cut_and_its_size_said(value: Any, type_name: str, text: str, length: int) -> None:
    assert value_text(value, type_name) == text
    assert len(value_text(value, type_name, ValueStyle(is_full=True))) == length


def test_what_is_just_short_enough_is_whole() -> None:
    assert value_text("ab" * 32, "ByteString") == "ab" * 32
    assert value_text([0] * 10, "Int32").count("0") == 10
    assert "…" not in value_text("x" * 200, "String")


def test_units_and_names_of_enumerations() -> None:
    assert value_text(24.5, "Double", ValueStyle("V")) == "24.5 V"
    assert value_text([1, 2], "Double", ValueStyle("m")) == "[1, 2] m"
    assert value_text(None, "Double", ValueStyle("V")) == "-"
    style = ValueStyle(names={1: "Idle"})
    assert value_text(1, "Int32", style) == "1 (Idle)"
    assert value_text(9, "Int32", style) == "9"
    assert value_text(True, "Boolean", style) == "true"


def test_times_are_of_the_zone_that_is_asked_for() -> None:
    assert moment_text(NOON, UTC) == "2030-01-31 12:00:00.000+00:00"
    assert moment_text(NOON, PARIS) == "2030-01-31 13:00:00.000+01:00"
    assert value_text(NOON.isoformat(), "DateTime", ValueStyle(zone=PARIS)) == "2030-01-31 13:00:00.000+01:00"
    assert clock_text(NOON, NOON + timedelta(hours=1), PARIS) == "13:00:00.000"
    assert clock_text(NOON, NOON + timedelta(hours=11, minutes=30), PARIS) == "2030-01-31 13:00:00.000+01:00"
    assert clock_text(None, NOON, UTC) == "-"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (12.46, "12.5 s"),
        (60, "1 min"),
        (125.4, "2 min 5 s"),
        (3600, "1 h"),
        (7500, "2 h 5 min"),
        (7199.6, "2 h"),
        (86_400 * 3 + 3 * 3600 + 59, "3 d 3 h"),
        (86_400 + 59, "1 d"),
        (-0.2, "-0.2 s"),
        (-125, "-2 min 5 s"),
    ],
)
def test_durations(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


def test_ages() -> None:
    assert age_text(NOON, NOON + timedelta(seconds=1.5)) == "1.5 s"
    assert age_text(None, NOON) == "-"


@pytest.mark.parametrize(
    ("status", "name", "words"),
    [
        (0, "Good", ""),
        (0x0000_0480, "Good", "Good (values were lost in the server's queue)"),
        (0x00A2_0000, "GoodEntryInserted", "GoodEntryInserted"),
        (0x8031_0000, "BadNoCommunication", "BadNoCommunication"),
        (0x4090_0000, "UncertainLastUsableValue", "UncertainLastUsableValue"),
    ],
)
def test_status_codes(status: int, name: str, words: str) -> None:
    assert status_words(status, name) == words


def test_the_first_and_the_last_time_have_no_other_zone() -> None:
    """A DateTime that means never is the last one there is (OPC 10000-6 5.2.2.5)."""
    last = datetime(9999, 12, 31, 23, 59, 59, 999000, tzinfo=UTC)
    assert value_text(last.isoformat(), "DateTime", ValueStyle(zone=PARIS)) == "9999-12-31 23:59:59.999+00:00"
    assert clock_text(last, NOON, PARIS) == "9999-12-31 23:59:59.999+00:00"
    west = timezone(timedelta(hours=-1))
    assert moment_text(datetime(1, 1, 1, tzinfo=UTC), west) == "0001-01-01 00:00:00.000+00:00"
