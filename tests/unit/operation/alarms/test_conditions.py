"""Alarms as state machines: levels with hysteresis and delay, what people do, what a quality does, and the bounds."""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import count, product
from math import inf, nan

import pytest

from ua_fleet.operation.alarms.condition import MAX_SHELVED_S, Condition, ConditionRefused, Shelving
from ua_fleet.operation.alarms.definitions import AlarmDefinition, AlarmKind
from ua_fleet.operation.alarms.levels import Level, Levels
from ua_fleet.values import NodeId, StatusCode

KEY = NodeId(2, 1001)
LEVELS = Levels(80, 90, 10, 5, 2)


def condition(kind: AlarmKind = AlarmKind.LEVEL, *, delay_s: float = 0, confirm: bool = False) -> Condition:
    numbers: Iterator[int] = count()
    definition = AlarmDefinition(
        "ur3.temperature",
        kind,
        KEY,
        "ur3.temperature",
        KEY,
        levels=LEVELS,
        delay_s=delay_s,
        needs_confirmation=confirm,
        unit="°C",
    )
    return Condition(definition, lambda: next(numbers).to_bytes(16))


@pytest.mark.parametrize(
    ("values", "levels"),
    [
        ([80, 80.1, 79, 78.1, 78], [0, 1, 1, 1, 0]),
        ([91, 89, 88.1, 88, 78.5, 78], [2, 2, 2, 1, 1, 0]),
        ([10, 9.9, 11, 11.9, 12], [0, -1, -1, -1, 0]),
        ([4, 6, 6.9, 7, 11, 12], [-2, -2, -2, -1, -1, 0]),
        ([95, 3, 95], [2, -2, 2]),
        ([inf, -inf, 50], [2, -2, 0]),
    ],
)
def test_levels_have_a_hysteresis(values: list[float], levels: list[int]) -> None:
    one, seen = condition(), list[int]()
    for value in values:
        one.take(value, 0, 1.0)
        seen.append(one.state.level)
    assert seen == levels


def test_the_band_of_a_level_is_what_does_not_change_it() -> None:
    around = [limit + step for limit in (5, 7, 10, 12, 78, 80, 88, 90) for step in (-1e-9, 0, 1e-9)]
    for before, value in product(Level, [*around, *[random.Random(7).uniform(0, 100) for _ in range(200)]]):
        least, greatest = LEVELS.band(before)
        assert (least <= value <= greatest) == (LEVELS.level(value, before) is before), (before, value)


def test_a_value_has_to_be_beyond_for_the_delay() -> None:
    one = condition(delay_s=1)
    assert not one.take(85, 0, 10.0)
    assert one.next_deadline() == 11.0
    assert not one.take(79, 0, 10.5), "back in time"
    assert one.next_deadline() is None
    assert not one.take(85, 0, 20.0)
    assert not one.poll(20.9)
    assert one.poll(21.0)
    assert one.state.level == Level.HIGH
    assert one.take(50, 0, 21.1), "the end has no delay"


@pytest.mark.parametrize(
    ("value", "status"), [(float("nan"), 0), (95.0, StatusCode.BAD_NO_COMMUNICATION), (95.0, StatusCode.UNCERTAIN)]
)
def test_values_in_between_that_say_nothing_put_off_no_alarm(value: float, status: int) -> None:
    one = condition(delay_s=1)
    one.take(50, 0, 0.0)
    told = [one.take(*((value, status) if tenth % 8 == 7 else (95.0, 0)), 10 + tenth / 10) for tenth in range(11)]
    assert told.index(True) == 10, "after 1 s"
    assert one.state.active


def test_a_level_that_waits_is_taken_with_a_value_and_forgotten_where_none_comes_for_longer_than_the_delay() -> None:
    one = condition(delay_s=1)
    one.take(50, 0, 0.0)
    one.take(95, 0, 10.0)
    one.take(95, StatusCode.BAD_NO_COMMUNICATION, 10.9)
    assert (one.next_deadline(), one.poll(11.5), one.state.active) == (None, False, False)
    assert one.take(95, 0, 11.8)
    assert one.state.active
    one.take(50, 0, 20.0)
    one.take(95, 0, 30.0)
    one.take(95, StatusCode.BAD_NO_COMMUNICATION, 30.5)
    one.take(95, 0, 31.6)
    assert (one.state.active, one.poll(32.6)) == (False, True), "what was meanwhile is not known"


def test_a_disable_that_was_not_recorded_leaves_the_delay_as_it_was() -> None:
    one = condition(delay_s=1)
    one.take(50, 0, 0.0)
    one.take(95, 0, 10.0)
    before = one.state
    one.disable()
    assert one.next_deadline() is None
    one.restored_state(before)
    assert one.poll(11.0)
    assert one.state.active


def test_an_enable_that_was_not_recorded_has_nothing_told() -> None:
    one = condition(delay_s=1)
    one.take(50, 0, 0.0)
    one.disable()
    one.take(95, 0, 5.0)
    before = one.state
    one.enable(10.0)
    one.restored_state(before)
    assert (one.poll(20.0), one.state.active) == (False, False)
    one.enable(30.0)
    assert one.next_deadline() == 31.0, "it begins anew"


def test_each_limit_has_its_own_delay() -> None:
    one = condition(delay_s=1)
    one.take(85, 0, 10.0)
    one.take(95, 0, 10.9)
    assert one.poll(11.0)
    assert one.state.level == Level.HIGH
    assert one.next_deadline() == 12.0
    assert one.poll(12.0)
    assert one.state.level == Level.HIGH_HIGH
    one.take(3, 0, 13.0)
    assert one.state.level == Level.HIGH_HIGH, "the other side waits as long"
    assert one.poll(14.0)


def test_one_alarm_from_active_to_forgotten() -> None:
    one = condition(confirm=True)
    assert not one.take(50, 0, 1.0)
    assert one.take(85, 0, 2.0)
    first = one.notified(2.0)
    assert (first.active, first.acked, first.confirmed, first.retain) == (True, False, True, True)
    assert first.severity == 500
    assert first.message == "ur3.temperature: 85 °C is above 80 °C"
    one.acknowledge(first.event_id, "seen", "olga", 3.0)
    second = one.notified(3.0)
    assert (second.acked, second.confirmed, second.comment, second.comment_by) == (True, False, "seen", "olga")
    assert one.take(95, 0, 4.0)
    third = one.notified(4.0)
    assert (third.acked, third.confirmed, third.severity, third.last_severity) == (False, True, 700, 500)
    one.acknowledge(third.event_id, None, "olga", 5.0)
    assert one.take(50, 0, 6.0)
    over = one.notified(6.0)
    assert (over.active, over.retain, over.comment) == (False, True, "seen")
    one.confirm(over.event_id, "mended", "olga", 7.0)
    assert not one.notified(7.0).retain


def test_less_severe_stays_acknowledged() -> None:
    one = condition()
    one.take(95, 0, 1.0)
    one.acknowledge(one.notified(1.0).event_id, None, "olga", 2.0)
    assert one.take(85, 0, 3.0)
    assert one.state.acked
    assert one.take(95, 0, 4.0)
    assert not one.state.acked


@pytest.mark.parametrize("status", [StatusCode.BAD_NO_COMMUNICATION, StatusCode.UNCERTAIN_LAST_USABLE_VALUE])
def test_a_value_that_is_not_good_keeps_the_state(status: StatusCode) -> None:
    one = condition()
    one.take(85, 0, 1.0)
    one.notified(1.0)
    assert one.take(20, status, 2.0), "its quality is told"
    assert (one.state.level, one.state.quality) == (Level.HIGH, status)
    assert not one.take(20, status, 2.0)
    assert one.take(20, 0, 3.0)
    assert (one.state.level, one.state.quality) == (Level.NORMAL, 0)


def test_what_is_no_number_says_nothing() -> None:
    one = condition()
    one.take(85, 0, 1.0)
    assert one.take(nan, 0, 2.0)
    assert (one.state.level, one.state.quality) == (Level.HIGH, StatusCode.UNCERTAIN)
    one.take("hot", 0, 3.0)
    one.take(None, 0, 3.0)
    assert one.state.level == Level.HIGH


def test_a_boolean_is_normal_or_not() -> None:
    one = condition(AlarmKind.OFF_NORMAL)
    assert not one.take(False, 0, 1.0)
    assert one.take(True, 0, 2.0)
    assert one.state.retain
    assert one.take(False, 0, 3.0)


def test_shelving() -> None:
    one = condition()
    one.take(85, 0, 1.0)
    with refused(StatusCode.BAD_CONDITION_NOT_SHELVED):
        one.unshelve()
    for time_s in (0, -1, MAX_SHELVED_S + 1, nan):
        with refused(StatusCode.BAD_SHELVING_TIME_OUT_OF_RANGE):
            one.shelve_for(time_s, 2.0)
    one.shelve_for(60, 2.0)
    with refused(StatusCode.BAD_CONDITION_ALREADY_SHELVED):
        one.shelve_for(60, 2.0)
    assert one.state.suppressed_or_shelved
    assert one.next_deadline() == 62.0
    one.shelve_once(3.0)
    with refused(StatusCode.BAD_CONDITION_ALREADY_SHELVED):
        one.shelve_once(3.0)
    assert not one.poll(62.0), "the time is that of OneShotShelved now"
    one.take(50, 0, 70.0)
    assert one.state.shelving is Shelving.UNSHELVED, "it was for this one alarm"
    one.shelve_for(10, 80.0)
    assert one.poll(90.0)
    assert not one.state.suppressed_or_shelved


def test_a_disabled_alarm_does_nothing_until_it_is_enabled() -> None:
    one = condition()
    with refused(StatusCode.BAD_CONDITION_ALREADY_ENABLED):
        one.enable(1.0)
    one.take(50, 0, 1.0)
    one.disable()
    assert not one.notified(1.0).retain
    with refused(StatusCode.BAD_CONDITION_ALREADY_DISABLED):
        one.disable()
    assert not one.take(95, 0, 2.0)
    for work in (one.unshelve, lambda: one.suppress(suppressed=True), lambda: one.add_comment(b"", "x", "o", 2.0)):
        with refused(StatusCode.BAD_CONDITION_DISABLED):
            work()
    one.enable(3.0)
    assert one.state.level == Level.HIGH_HIGH, "as the last value is"


def test_only_events_of_the_alarm_are_acknowledged() -> None:
    one = condition()
    one.take(85, 0, 1.0)
    event_id = one.notified(1.0).event_id
    for wrong in (b"", None, b"x" * 16):
        with refused(StatusCode.BAD_EVENT_ID_UNKNOWN):
            one.acknowledge(wrong, None, "olga", 2.0)
    one.acknowledge(event_id, None, "olga", 2.0)
    with refused(StatusCode.BAD_CONDITION_BRANCH_ALREADY_ACKED):
        one.acknowledge(event_id, None, "olga", 2.0)
    with refused(StatusCode.BAD_NOT_SUPPORTED):
        one.confirm(event_id, None, "olga", 2.0)


class refused:  # noqa: N801 - as pytest.raises
    """Refused with a StatusCode, and one line that says why."""

    def __init__(self, code: StatusCode) -> None:
        self._code = code

    def __enter__(self) -> None:
        return

    def __exit__(self, _kind: object, error: BaseException | None, _traceback: object) -> bool:
        assert isinstance(error, ConditionRefused), error
        assert error.ua_status == self._code
        assert "\n" not in str(error)
        return True
