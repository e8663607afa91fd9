"""Reconnection with jitter: how long the clients of a broker wait before they come back."""

from __future__ import annotations

from collections import Counter
from itertools import accumulate
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.transport.mqtt.pauses import FIRST_S, LONGEST_S, SPREAD, Pauses

CLIENTS = 1000
MIDDLES = (0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0)
"""Of the pauses one after the other, in seconds."""


def pauses_of(seed: int, count: int = len(MIDDLES)) -> list[float]:
    pauses = Pauses(Random(seed))
    return [pauses.next_s() for _ in range(count)]


@given(seed=st.integers(0, 2**64))
def test_each_pause_is_about_twice_the_one_before_and_bounded(seed: int) -> None:
    low, high = SPREAD
    for pause_s, middle_s in zip(pauses_of(seed), MIDDLES, strict=True):
        assert low * middle_s <= pause_s <= high * middle_s
    assert MIDDLES[0] == FIRST_S
    assert all(pause_s <= high * LONGEST_S for pause_s in pauses_of(seed, 50))


def test_one_source_of_randomness_makes_the_same_pauses_again_and_another_one_others() -> None:
    assert pauses_of(1) == pauses_of(1)
    assert pauses_of(1) != pauses_of(2)


def test_after_a_connection_that_has_lasted_the_pauses_begin_anew() -> None:
    pauses = Pauses(Random(7))
    for _ in MIDDLES:
        pauses.next_s()
    pauses.begin_anew()
    assert FIRST_S * SPREAD[0] <= pauses.next_s() <= FIRST_S * SPREAD[1]


@pytest.mark.parametrize("attempt", range(5))
def test_many_clients_that_lose_a_broker_together_do_not_come_back_together(attempt: int) -> None:
    """Their first attempts are spread evenly; later ones are sums, closer to the middle of a wider time."""
    times = [list(accumulate(pauses_of(seed)))[attempt] for seed in range(CLIENTS)]
    spread = max(times) - min(times)
    assert spread > 0.9 * (SPREAD[1] - SPREAD[0]) * FIRST_S * 2**attempt
    tenths = Counter(min(int(10 * (at - min(times)) / spread), 9) for at in times)
    if attempt == 0:  # evenly: each pause is as likely
        assert all(0.6 * CLIENTS / 10 < tenths[tenth] < 1.4 * CLIENTS / 10 for tenth in range(10))
    assert max(tenths.values()) < 3 * CLIENTS / 10
    assert len(set(times)) == CLIENTS
