from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.pubsub.sequence import MASK, NEWEST_STEP, MissingNumbers

NUMBERS = st.integers(0, MASK)


@given(received=NUMBERS, last=NUMBERS)
def test_newer_is_what_the_specification_calls_newer(received: int, last: int) -> None:
    """OPC 10000-14 7.2.3, in 16 bits: the table at the top of sequence.py is the same test."""
    d = (0xFFFF + received - last) % 0x10000
    step = (received - last) & MASK
    assert (d < 2**14) == (1 <= step <= NEWEST_STEP)


@given(first=NUMBERS, count=st.integers(1, 200), pick=st.integers(0, 199))
def test_a_missing_number_arrives_once(first: int, count: int, pick: int) -> None:
    missing = MissingNumbers()
    missing.skipped(first, count)
    expected = (first + count + 1) & MASK
    number = (first + pick) & MASK
    assert missing.arrived(number, expected) == (pick < count)
    assert not missing.arrived(number, expected)


def test_only_the_newest_missing_numbers_are_remembered() -> None:
    missing = MissingNumbers()
    missing.skipped(0, 10_000)
    assert not missing.arrived(9_000, 10_001)
    assert missing.arrived(9_900, 10_001)


def test_a_number_of_an_earlier_round_is_not_missing_any_more() -> None:
    missing = MissingNumbers()
    missing.skipped(10, 1)
    assert not missing.arrived(10, 40_000)


def test_a_restart_forgets_what_was_missing() -> None:
    missing = MissingNumbers()
    missing.skipped(10, 5)
    missing.clear()
    assert not missing.arrived(12, 20)
