"""What is written of robots in short, and when."""

from __future__ import annotations

from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.fleet.summaries import PERIOD_S, Summaries, SummaryRecord

EVERYTHING: Final = 1000
PLAIN: Final = SummaryRecord("", 1, 0, 0, 0, "", "", False, "", 0, "", 0, "", "floor", ())


def robot(name: str, last_update: int = 0) -> SummaryRecord:
    return PLAIN._replace(name=name, last_update=last_update)


def names(summaries: Summaries, number: int) -> list[str]:
    return [summary.name for summary in summaries.group(number)]


def test_robots_stand_in_their_order_and_the_last_group_is_empty() -> None:
    summaries = Summaries(group_size=2)
    assert len(summaries) == 1
    for name in ("a", "b", "c"):
        summaries.put(robot(name))
    assert [names(summaries, number) for number in range(len(summaries))] == [["a", "b"], ["c"], []]
    summaries.put(robot("d"))
    assert [names(summaries, number) for number in range(len(summaries))] == [["a", "b"], ["c", "d"], []]


def test_who_comes_later_gets_a_place_that_is_free() -> None:
    summaries = Summaries(group_size=2)
    for name in ("a", "b", "c"):
        summaries.put(robot(name))
    summaries.remove("a")
    summaries.remove("nobody")
    summaries.put(robot("d"))
    assert [names(summaries, number) for number in range(len(summaries))] == [["b", "d"], ["c"], []]


def test_the_first_change_is_due_at_once_and_the_next_ones_together() -> None:
    summaries = Summaries()
    assert summaries.next_deadline() is None
    summaries.put(robot("a", 1))
    deadline = summaries.next_deadline()
    assert deadline is not None
    assert deadline <= 5.0
    assert summaries.take_due(5.0, EVERYTHING) == [0]
    summaries.put(robot("a", 2))
    summaries.put(robot("b", 2))
    assert summaries.next_deadline() == 5.0 + PERIOD_S
    assert summaries.take_due(5.9, EVERYTHING) == []
    assert summaries.take_due(6.0, EVERYTHING) == [0]
    assert [summary.last_update for summary in summaries.group(0)] == [2, 2]
    assert summaries.next_deadline() is None


def test_what_is_said_again_is_no_change() -> None:
    summaries = Summaries()
    summaries.put(robot("a"))
    summaries.take_due(0.0, EVERYTHING)
    summaries.put(robot("a"))
    assert summaries.next_deadline() is None


def test_a_turn_has_a_bound_and_nobody_waits_for_ever() -> None:
    summaries = Summaries(group_size=1)
    for number in range(5):
        summaries.put(robot(str(number)))
    written: list[int] = []
    for turn in range(5):
        written += summaries.take_due(turn / 10, 1)
        summaries.put(robot("0", turn + 1))  # who changes all the time does not go before the others
    assert sorted(written) == [0, 1, 2, 3, 4]


STEPS = st.lists(
    st.tuples(st.sampled_from("abcdefg"), st.integers(0, 3), st.booleans(), st.floats(0.0, 0.7)), max_size=60
)


@given(STEPS)
def test_no_change_is_lost_and_none_is_told_too_often(steps: list[tuple[str, int, bool, float]]) -> None:
    summaries = Summaries(group_size=2)
    now = 0.0
    told: dict[int, tuple[SummaryRecord, ...]] = {}
    told_at: dict[int, float] = {}
    there: dict[str, SummaryRecord] = {}

    def poll() -> None:
        deadline = summaries.next_deadline()
        due = summaries.take_due(now, EVERYTHING)
        if deadline is None or deadline > now:
            assert due == []
        for number in due:
            assert now >= told_at.get(number, -PERIOD_S) + PERIOD_S
            told_at[number], told[number] = now, summaries.group(number)

    for name, last_update, is_gone, pause in steps:
        if is_gone:
            there.pop(name, None)
            summaries.remove(name)
        else:
            there[name] = robot(name, last_update)
            summaries.put(there[name])
        poll()
        now += pause
    for _ in range(3):
        now = max(now, deadline) if (deadline := summaries.next_deadline()) is not None else now
        poll()
    assert summaries.next_deadline() is None
    assert {summary.name: summary for group in told.values() for summary in group} == there
    assert all(len(group) <= 2 for group in told.values())
    assert summaries.group(len(summaries) - 1) == ()


@pytest.mark.parametrize("count", [99, 100, 101, 250])
def test_a_hundred_robots_are_one_group(count: int) -> None:
    summaries = Summaries()
    for number in range(count):
        summaries.put(robot(f"r{number}"))
    sizes = [len(summaries.group(number)) for number in range(len(summaries))]
    assert sizes[-1] == 0
    assert sum(sizes) == count
    assert max(sizes) <= 100
    assert len(sizes) == -(-count // 100) + 1
