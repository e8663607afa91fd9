from __future__ import annotations

from ua_fleet.bridge.told import MOST_TOLD, REMEMBERED_S, ToldReasons
from ua_fleet.counters import Drop


def test_a_reason_is_told_once_an_hour() -> None:
    told = ToldReasons()
    assert told.is_due(Drop.CONVERSION, "/a: not a number", 0.0)
    assert not told.is_due(Drop.CONVERSION, "/a: not a number", REMEMBERED_S - 1)
    assert told.is_due(Drop.CONFLICT, "/a: not a number", 1.0)
    assert told.is_due(Drop.CONVERSION, "/a: not a number", REMEMBERED_S)


def test_a_flood_of_reasons_is_bounded_and_does_not_silence_for_ever() -> None:
    told = ToldReasons()
    lines = sum(told.is_due(Drop.CONVERSION, f"hostile {number}", number / 100) for number in range(10_000))
    assert lines == MOST_TOLD
    assert not told.is_due(Drop.TYPE_MISSING, "honest", 200.0)
    assert told.is_due(Drop.TYPE_MISSING, "honest", REMEMBERED_S + 200.0)
