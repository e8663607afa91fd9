"""Each number once, never an old one, also where numbers roll over."""

from __future__ import annotations

from collections import Counter
from random import Random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ua_fleet.pubsub.security.replay import LAST_NUMBER, MOST_WINDOWS, WINDOW, ReplayWindow, ReplayWindows

TOP = 1 << 32
STEP = 1 << 30

CASES: dict[str, tuple[bool, list[tuple[int, bool]]]] = {
    # is_unused, then numbers with whether they are taken; the first one always is.
    "in order": (False, [(1, True), (2, True), (3, True)]),
    "the same one again": (False, [(7, True), (7, False)]),
    "out of order": (False, [(1, True), (3, True), (2, True), (2, False), (3, False)]),
    "older than the first one, of a key in use": (False, [(7, True), (6, False), (8, True), (6, False)]),
    "older than the first one, of an unused key": (True, [(7, True), (6, True), (6, False), (1, True)]),
    "the last one in the window": (False, [(1, True), (1025, True), (2, True), (1, False)]),
    "one that has left the window": (False, [(1, True), (2, True), (2000, True), (976, False), (977, True)]),
    "a block later, after a restart": (False, [(1, True), (65_537, True), (2, False), (65_538, True)]),
    "the farthest that is newer": (False, [(1, True), (1 + STEP, True)]),
    "one farther is invalid": (False, [(1, True), (2 + STEP, False), (2, True)]),
    "half the way round is invalid": (False, [(1, True), (1 + TOP // 2, False)]),
    "old": (False, [(5_000_000, True), (5_000_001, True), (1_000_000, False)]),
    "over the top": (False, [(TOP - 1, True), (0, True), (1, True), (0, False), (TOP - 1, False)]),
    "over the top, out of order": (False, [(TOP - 2, True), (1, True), (TOP - 1, True), (0, True), (TOP - 1, False)]),
    "over the top, an old one": (False, [(TOP - 2, True), (2, True), (TOP - 3, False), (TOP - 4000, False)]),
    "0 at first": (False, [(0, True), (0, False), (1, True), (TOP - 1, False)]),
    "0 at first, of an unused key": (True, [(0, True), (0, False), (TOP - 1, True), (TOP - 1, False)]),
    "the same slot": (False, [(5, True), (5 + WINDOW, True), (5, False), (5 + WINDOW, False)]),
}


@pytest.mark.parametrize(("is_unused", "steps"), CASES.values(), ids=CASES.keys())
def test_window(is_unused: bool, steps: list[tuple[int, bool]]) -> None:
    windows = ReplayWindows(is_unused=is_unused)
    assert [(number, windows.take(0, number)) for number, _ in steps] == steps


def test_a_window_that_has_walked_too_far_takes_nothing_newer() -> None:
    """Beyond, the first numbers would look newer again."""
    window = ReplayWindow(1, is_unused=False)
    assert [window.take(1 + STEP), window.take(1 + 2 * STEP), window.take(1 + 3 * STEP)] == [True] * 3
    assert not window.take(2 + 3 * STEP)
    assert window.take(3 * STEP), "what is in the window may still come"
    assert not window.take(1), "the first number again"
    assert 3 * STEP == LAST_NUMBER


@settings(max_examples=300)
@given(
    first=st.integers(0, TOP - 1),
    is_unused=st.booleans(),
    steps=st.lists(
        st.one_of(st.integers(-3000, 3000), st.integers(-TOP, TOP), st.sampled_from([STEP, STEP + 1, -STEP, STEP - 1]))
    ),
)
@example(first=0, is_unused=True, steps=[STEP, STEP, STEP, STEP, 1])
def test_each_number_is_taken_once_and_never_an_old_one(first: int, is_unused: bool, steps: list[int]) -> None:
    window = ReplayWindow(first, is_unused=is_unused)
    taken = Counter([first])
    highest = number = first
    walked = 0
    for step in steps:
        number = (number + step) % TOP
        ahead = (number - highest) % TOP
        if window.take(number):
            taken[number] += 1
            if ahead <= STEP:
                highest, walked = number, walked + ahead
            else:
                assert TOP - ahead < WINDOW, "older than the window"
                assert is_unused or TOP - ahead <= walked, "older than the first one heard"
    assert max(taken.values()) == 1
    assert walked <= LAST_NUMBER


@settings(max_examples=50)
@given(start=st.integers(0, TOP - 1), count=st.integers(1, 300), random=st.randoms(use_true_random=False))
def test_whatever_a_network_reorders_within_the_window_arrives(start: int, count: int, random: Random) -> None:
    numbers = [(start + i) % TOP for i in range(count)]
    tail = numbers[1:] * 2
    random.shuffle(tail)
    window = ReplayWindow(start, is_unused=False)
    assert Counter(number for number in tail if window.take(number)) == Counter(numbers[1:])


def test_senders_have_windows_of_their_own_and_not_too_many() -> None:
    windows = ReplayWindows(is_unused=False)
    assert all(windows.take(sender, 5) for sender in range(MOST_WINDOWS))
    assert not windows.take(MOST_WINDOWS, 5), "what a window remembers is not given up for another sender"
    assert not windows.take(3, 5)
    assert windows.take(3, 6)
