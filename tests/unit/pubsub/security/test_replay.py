"""Each number once, and nobody kept out by what another has sent."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from random import Random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ua_fleet.pubsub.security.nonces import BLOCK
from ua_fleet.pubsub.security.replay import FEW, MOST_PAGES, MOST_WINDOWS, PAGE, ReplayWindow, ReplayWindows

TOP = 1 << 32
STEP = 1 << 30
NUMBERS = st.one_of(st.integers(0, 300_000), st.integers(0, TOP - 1), st.integers(0, TOP // PAGE - 1).map(PAGE.__mul__))

CASES: dict[str, tuple[bool, list[tuple[int, bool]]]] = {
    # is_unused, then numbers with whether they are taken; the first one always is.
    "in order": (False, [(1, True), (2, True), (3, True)]),
    "the same one again": (False, [(7, True), (7, False)]),
    "out of order": (False, [(1, True), (3, True), (2, True), (2, False), (3, False)]),
    "older than the first one, of a key in use": (False, [(7, True), (6, False), (8, True), (6, False)]),
    "older than the first one, of an unused key": (True, [(7, True), (6, True), (6, False), (1, True)]),
    "a jump, and what was before it": (False, [(1, True), (1 + STEP, True), (2, True), (1 + STEP, False), (2, False)]),
    "a jump at first, of an unused key": (True, [(STEP, True), (1, True), (2, True)]),
    "a block later, after a restart": (False, [(1, True), (65_537, True), (2, True), (65_538, True), (65_537, False)]),
    "after a network that was away for long": (False, [(1, True), (3 << 30, True), ((3 << 30) + 1, True)]),
    "the highest ones, and 0": (True, [(TOP - 1, True), (0, True), (1, True), (0, False), (TOP - 1, False)]),
    "0 at first": (False, [(0, True), (0, False), (1, True)]),
    "the same place of another page": (False, [(5, True), (5 + PAGE, True), (5, False), (5 + PAGE, False)]),
    "the edges of a page": (True, [(PAGE, True), (PAGE + 1, True), (1, True), (PAGE, False), (PAGE + 1, False)]),
}


@pytest.mark.parametrize(("is_unused", "steps"), CASES.values(), ids=CASES.keys())
def test_window(is_unused: bool, steps: list[tuple[int, bool]]) -> None:
    windows = ReplayWindows(is_unused=is_unused)
    assert [(number, windows.take(0, number)) for number, _ in steps] == steps


@settings(max_examples=200)
@given(numbers=st.lists(NUMBERS, max_size=100), others=st.lists(NUMBERS, max_size=20))
@example(numbers=[1 + PAGE * page for page in range(40)], others=[2, 2 + PAGE])
def test_what_was_taken_is_known_and_of_what_was_not_only_closed_pages_are(
    numbers: list[int], others: list[int]
) -> None:
    windows = ReplayWindows(is_unused=True)
    taken = {number for number in numbers if windows.take(7, number)}
    assert all(windows.has(7, number) for number in taken)
    for number in set(others) - taken:
        assert windows.has(7, number) is not windows.take(7, number)
    assert not windows.has(8, 1)


@settings(max_examples=300)
@given(first=NUMBERS, is_unused=st.booleans(), numbers=st.lists(NUMBERS, max_size=200))
@example(first=1, is_unused=True, numbers=[PAGE * page for page in range(40)] * 2)
def test_each_number_is_taken_once_and_of_a_key_in_use_none_before_the_first(
    first: int, is_unused: bool, numbers: list[int]
) -> None:
    windows = ReplayWindows(is_unused=is_unused)
    taken = Counter(number for number in [first, *numbers, *numbers, first] if windows.take(0, number))
    assert max(taken.values()) == 1
    assert is_unused or min(taken) == first


@settings(max_examples=200)
@given(
    is_unused=st.booleans(),
    acts=st.lists(
        st.one_of(
            st.tuples(st.just("send"), st.integers(1, 20)),
            st.tuples(st.just("lost"), st.integers(1, 200_000)),
            st.tuples(st.just("restart"), st.integers(1, 3)),
            st.tuples(st.just("insider"), st.lists(NUMBERS, max_size=MOST_PAGES - 1)),
        ),
        max_size=60,
    ),
)
def test_no_accepted_message_keeps_the_honest_ones_out(
    is_unused: bool, acts: list[tuple[str, int | list[int]]]
) -> None:
    """The sender goes on from block to block, a restart jumps to the next; whatever an insider writes in between."""
    windows, taken, number = ReplayWindows(is_unused=is_unused), {1}, 1
    assert windows.take(0, 1)
    for act, how in acts:
        if act == "send":
            assert isinstance(how, int)
            for _ in range(how):
                number += 1
                assert windows.take(0, number) is (number not in taken), number
                assert not windows.take(0, number)
                taken.add(number)
        elif act == "insider":
            assert isinstance(how, list)
            for forged in how:
                if windows.take(0, forged):
                    assert forged not in taken
                    taken.add(forged)
        else:
            assert isinstance(how, int)
            number = number + how if act == "lost" else ((number - 1) // BLOCK + how) * BLOCK + how
            number = max(number, 1)


def test_a_page_that_was_written_ahead_is_open_when_its_sender_comes_to_it() -> None:
    windows = ReplayWindows(is_unused=True)
    ahead = 40 * PAGE + 5
    assert windows.take(0, ahead)
    for page in range(40):  # a restart each
        assert windows.take(0, page * PAGE + 1)
    assert not windows.take(0, ahead)
    assert windows.take(0, 40 * PAGE + 1)
    assert all(windows.take(0, 40 * PAGE + number) for number in range(6, 1_000))


def test_numbers_that_are_spread_over_pages_without_end_take_no_memory_without_end() -> None:
    windows = ReplayWindows(is_unused=True)
    taken = [page * PAGE + 1 for page in range(6_000)]
    assert all(windows.take(0, number) for number in taken)
    assert not any(windows.take(0, number) for number in taken)


@settings(max_examples=50)
@given(start=st.integers(1, TOP - 400), count=st.integers(1, 300), random=st.randoms(use_true_random=False))
def test_whatever_a_network_reorders_arrives(start: int, count: int, random: Random) -> None:
    numbers = list(range(start, start + count))
    tail = numbers[1:] * 2
    random.shuffle(tail)
    window = ReplayWindow(start)
    assert window.take(start)
    assert Counter(number for number in tail if window.take(number)) == Counter(numbers[1:])


def test_a_page_that_was_closed_takes_nothing_again() -> None:
    window = ReplayWindow()
    assert all(window.take(number) for number in range(1, FEW + 2))
    firsts = [page * PAGE + 1 for page in range(MOST_PAGES + 1)]
    assert all(window.take(number) for number in firsts[1:])
    assert not window.take(1)
    assert not window.take(FEW + 2), "what was taken of it is not known any more"
    assert window.take(firsts[1] + 1), "the others are open"


def test_the_page_in_use_is_not_the_one_that_is_closed() -> None:
    window = ReplayWindow()
    for number in range(1, 2000):
        assert window.take(number)
        assert window.take(number * 500_000 + 200_000), "an insider with a page of its own for each message"


def test_a_window_stays_small_whatever_is_sent() -> None:
    tracemalloc.start()
    try:
        window = ReplayWindow()
        for number in range(0, TOP, PAGE):
            window.take(number)
        size, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert size < 200_000


def test_senders_have_windows_of_their_own_and_not_too_many() -> None:
    windows = ReplayWindows(is_unused=False)
    assert all(windows.take(sender, 5) for sender in range(MOST_WINDOWS))
    assert not windows.take(MOST_WINDOWS, 5), "what a window remembers is not given up for another sender"
    assert not windows.take(3, 5)
    assert windows.take(3, 6)
