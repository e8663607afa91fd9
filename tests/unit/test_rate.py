from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.rate import Budget, RateLimit


def test_first_goes_at_once_and_the_latest_waits_for_its_turn() -> None:
    limit = RateLimit[str](10.0)
    assert limit.offer("a", 0.0) == ("a", False)
    assert limit.offer("b", 0.01) == (None, False)
    assert limit.offer("c", 0.02) == (None, True)
    assert limit.due == 0.1
    assert limit.pop(0.09) is None
    assert limit.pop(0.1) == "c"
    assert limit.pop(0.5) is None


def test_item_that_comes_at_its_turn_replaces_the_one_that_waited() -> None:
    limit = RateLimit[str](10.0)
    limit.offer("a", 0.0)
    limit.offer("b", 0.05)
    assert limit.offer("c", 0.2) == ("c", True)
    assert limit.pop(0.9) is None


@given(st.lists(st.floats(min_value=0.0, max_value=1.0), min_size=1, max_size=50), st.floats(0.5, 50.0))
def test_rate_holds_and_the_last_one_always_arrives(gaps: list[float], rate: float) -> None:
    limit = RateLimit[int](rate)
    now, passed = 0.0, list[tuple[float, int]]()
    for number, gap in enumerate(gaps):
        while limit.due is not None and limit.due <= now + gap:
            due = limit.due
            item = limit.pop(due)
            assert item is not None
            passed.append((due, item))
        now += gap
        item, _ = limit.offer(number, now)
        if item is not None:
            passed.append((now, item))
    if limit.due is not None:
        item = limit.pop(limit.due)
        assert item is not None
        passed.append((now, item))
    assert passed[-1][1] == len(gaps) - 1
    times = [time for time, _ in passed[:-1]]
    assert all(later - earlier >= 1.0 / rate - 1e-9 for earlier, later in itertools.pairwise(times))
    assert [number for _, number in passed] == sorted({number for _, number in passed})


def test_a_burst_passes_and_then_one_by_one() -> None:
    limit = RateLimit[int](2.0, burst=2.0)
    assert [limit.offer(number, number * 0.5)[0] for number in range(5)] == [0, 1, 2, 3, 4]
    assert [limit.due] == [None]
    assert limit.offer(5, 2.0) == (5, False)
    assert limit.offer(6, 2.0) == (None, False)
    assert limit.due == 2.5
    assert limit.pop(2.5) == 6


def test_what_overtakes_takes_the_place_of_what_waits() -> None:
    limit = RateLimit[str](10.0)
    limit.offer("a", 0.0)
    limit.offer("b", 0.05)
    limit.overtake(0.08)
    assert [limit.due] == [None]
    assert limit.offer("c", 0.1) == (None, False)
    limit.replace("d")
    assert limit.due == 0.08 + 0.1
    assert limit.pop(0.17) is None
    assert limit.pop(0.19) == "d"


def test_an_item_passes_where_none_waits_and_counts() -> None:
    limit: RateLimit[str] = RateLimit(10.0)
    assert limit.passes(0.0)
    assert not limit.passes(0.05)
    assert limit.offer("a", 0.05) == (None, False)
    assert not limit.passes(0.2), "one that waits goes first"
    assert limit.pop(0.2) == "a"
    assert limit.passes(0.31)


def test_a_budget_grows_up_to_the_most_and_may_be_overdrawn() -> None:
    budget = Budget(4.0, most=8.0)
    assert budget.left(100.0) == 8.0
    budget.spend(100.0, 12.0)
    assert budget.left(100.0) == -4.0
    assert budget.at(0.0) == 101.0
    assert not budget.take(101.0)
    assert budget.take(101.25)
    assert budget.left(101.25) == 0.0
    assert budget.left(1000.0) == 8.0


@given(st.lists(st.tuples(st.floats(0, 3), st.integers(1, 5)), max_size=60))
def test_a_budget_is_a_bucket_that_fills(spent: list[tuple[float, int]]) -> None:
    budget, left, now = Budget(2.0, most=10.0), 10.0, 0.0
    for pause, amount in spent:
        now += pause
        left = min(left + pause * 2.0, 10.0)
        assert abs(budget.left(now) - left) < 1e-6
        budget.spend(now, amount)
        left -= amount
