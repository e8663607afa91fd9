"""Which keys count when, on both sides, by clocks that differ."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.unit.pubsub.security.securing import AES256, group_keys, key_data
from ua_fleet.errors import LocalWireError
from ua_fleet.pubsub.security.keyring import MAX_TOKEN_ID, GroupKeys, Keyring, next_token_id


def sent_with(keyring: Keyring, now: float) -> int | None:
    token = keyring.sending(now)
    return None if token is None else token.token_id


def taken(keyring: Keyring, now: float) -> set[int]:
    keyring.advance(now)
    return set(keyring.tokens)


def ring(keys: GroupKeys | None = None, past_keys: int = 1) -> Keyring:
    made = Keyring("t-1", past_keys)
    made.install(keys or group_keys(), 0.0)
    return made


def test_a_publisher_moves_to_the_next_key_by_itself() -> None:
    keyring = ring(group_keys(7, 3, next_s=10.0))
    assert [sent_with(keyring, now) for now in (0.0, 9.99, 10.0, 69.9, 70.0)] == [7, 7, 8, 8, 9]


def test_how_long_the_keys_last_is_known() -> None:
    keyring = ring(group_keys(7, 3, next_s=10.0))
    lasts = {now: keyring.lasts_s(now) for now in (0.0, 10.0, 130.0, 249.0, 250.0)}
    assert lasts == {0.0: 130.0, 10.0: 120.0, 130.0: 0.0, 249.0: -119.0, 250.0: None}


def test_readers_take_future_keys_and_past_ones_for_one_more_lifetime() -> None:
    keyring = ring(group_keys(7, 4, next_s=10.0))
    assert taken(keyring, 0.0) == {7, 8, 9, 10}
    assert taken(keyring, 69.9) == {7, 8, 9, 10}
    assert taken(keyring, 70.0) == {8, 9, 10}
    assert taken(keyring, 130.0) == {9, 10}


@pytest.mark.parametrize(("past_keys", "until"), [(0, 10.0), (1, 70.0), (3, 190.0)])
def test_how_long_a_replaced_key_is_taken_is_configured(past_keys: int, until: float) -> None:
    keyring = ring(group_keys(7, 9, next_s=10.0), past_keys)
    assert 7 in taken(keyring, until - 0.1)
    assert 7 not in taken(keyring, until)


@pytest.mark.parametrize("past_keys", [0, 1, 16])
def test_the_last_key_is_used_two_lifetimes_longer_and_then_not_at_all(past_keys: int) -> None:
    keyring = ring(group_keys(7, 2, next_s=10.0), past_keys)
    end = 10.0 + 60.0 + 2 * 60.0
    assert sent_with(keyring, end - 0.1) == 8
    assert 8 in taken(keyring, end - 0.1)
    assert sent_with(keyring, end) is None
    assert taken(keyring, end) == set()
    assert keyring.is_wanted(end)


def test_new_keys_bring_an_expired_ring_back() -> None:
    keyring = ring(group_keys(7, 1))
    assert sent_with(keyring, 1000.0) is None
    keyring.install(group_keys(20, 1), 1000.0)
    assert sent_with(keyring, 1000.0) == 20


def test_keys_are_wanted_at_first_at_half_of_the_lifetime_and_when_asked_for() -> None:
    keyring = Keyring("t-1")
    assert keyring.is_wanted(0.0)
    keyring.install(group_keys(), 0.0)
    assert [keyring.is_wanted(now) for now in (0.0, 29.9, 30.0)] == [False, False, True]
    keyring.install(group_keys(), 30.0)
    assert not keyring.is_wanted(31.0)
    keyring.ask()
    assert keyring.is_wanted(31.0)
    keyring.install(group_keys(), 31.0)
    assert not keyring.is_wanted(31.0)


def test_a_negative_time_to_the_next_key_means_now() -> None:
    keyring = ring(group_keys(7, 3, next_s=-5.0))
    assert [sent_with(keyring, now) for now in (0.0, 59.9, 60.0)] == [8, 8, 9]
    assert 7 in taken(ring(group_keys(7, 3, next_s=-5.0)), 0.0)


def test_known_keys_keep_what_was_heard_under_them() -> None:
    keyring = ring(group_keys(7, 3, next_s=10.0))
    before = dict(keyring.tokens)
    assert before[8].windows.take(0, 5)
    keyring.install(group_keys(8, 3, next_s=55.0), 15.0)
    assert keyring.tokens[8] is before[8]
    assert keyring.tokens[7] is before[7], "the past one is kept for its time"
    assert not keyring.tokens[8].windows.take(0, 5)
    assert set(keyring.tokens) == {7, 8, 9, 10}


def test_a_fetched_list_that_is_shorter_takes_no_future_key_away() -> None:
    keyring = ring(group_keys(7, 4, next_s=10.0))
    keyring.install(group_keys(7, 1, next_s=5.0), 5.0)
    assert taken(keyring, 5.0) == {7, 8, 9, 10}


def test_forced_rotation_moves_on_before_the_time() -> None:
    keyring = ring(group_keys(7, 3, next_s=50.0))
    keyring.install(group_keys(8, 3, next_s=60.0), 5.0)
    assert sent_with(keyring, 5.0) == 8
    assert 7 in taken(keyring, 64.9)
    assert 7 not in taken(keyring, 65.0)


def test_a_clock_that_is_ahead_of_the_service_does_not_go_back() -> None:
    keyring = ring(group_keys(7, 4, next_s=10.0))
    assert sent_with(keyring, 10.0) == 8
    keyring.install(group_keys(7, 4, next_s=2.0), 10.5)
    assert sent_with(keyring, 10.5) == 8
    assert [sent_with(keyring, now) for now in (72.4, 72.5)] == [8, 9], "but it follows the service's times"


def test_an_unknown_current_token_replaces_all() -> None:
    keyring = ring(group_keys(7, 3))
    keyring.install(group_keys(50, 2), 5.0)
    assert taken(keyring, 5.0) == {50, 51}


def test_another_key_under_the_same_token_replaces_all() -> None:
    keyring = ring(group_keys(1, 3))
    assert keyring.tokens[1].windows.take(0, 9)
    keyring.install(group_keys(1, 2, seed="restarted"), 5.0)
    assert taken(keyring, 5.0) == {1, 2}
    assert keyring.tokens[1].is_key(key_data(1, "restarted"))
    assert keyring.tokens[1].windows.take(0, 9), "another key has another window"


def test_another_future_key_replaces_the_known_one_and_those_after_it() -> None:
    keyring = ring(group_keys(1, 4))
    mixed = group_keys(1, 2)._replace(keys=(key_data(1), key_data(2, "other")))
    keyring.install(mixed, 5.0)
    assert taken(keyring, 5.0) == {1, 2}
    assert keyring.tokens[2].is_key(key_data(2, "other"))


def test_token_ids_begin_anew_at_1() -> None:
    assert next_token_id(MAX_TOKEN_ID) == 1
    keyring = ring(group_keys(MAX_TOKEN_ID, 3, next_s=10.0))
    assert [sent_with(keyring, now) for now in (0.0, 10.0, 70.0)] == [MAX_TOKEN_ID, 1, 2]


def test_after_a_long_rest_the_key_is_that_of_the_time() -> None:
    assert sent_with(ring(group_keys(1, 5, next_s=10.0)), 135.0) == 4


def test_an_empty_list_changes_nothing() -> None:
    keyring = ring()
    keyring.install(group_keys()._replace(keys=()), 1.0)
    assert taken(keyring, 1.0) == {1, 2, 3}


def test_key_data_of_another_length_changes_nothing() -> None:
    keyring = ring()
    with pytest.raises(LocalWireError, match="68 bytes, not 3"):
        keyring.install(GroupKeys(AES256, 9, (b"abc",), 1.0, 1.0), 1.0)
    assert taken(keyring, 1.0) == {1, 2, 3}


def test_a_source_that_gives_thousands_of_keys_is_cut_short() -> None:
    assert len(ring(group_keys(1, 2000)).tokens) == 256


def test_nothing_changes_between_the_times_that_it_says() -> None:
    keyring = ring(group_keys(7, 3, next_s=10.0))
    changes: list[float] = []
    while keyring.changes_at < math.inf:
        changes.append(keyring.changes_at)
        keyring.advance(keyring.changes_at)
    assert changes == [10.0, 70.0, 130.0, 250.0]


def test_no_representation_shows_a_key() -> None:
    keys = group_keys(7, 2)
    keyring = ring(keys)
    token = keyring.tokens[7]
    shown = f"{keys!r} {keys} {keyring!r} {token!r} {token.windows!r} {token.key!r}"
    assert shown.startswith("GroupKeys(PubSub-Aes256-CTR, 2 keys from token 7, next in 60 s, lifetime 60 s)")
    for data in keys.keys:
        assert data.hex() not in shown
        assert repr(data) not in shown


@settings(max_examples=300)
@given(
    past_keys=st.integers(0, 3),
    steps=st.lists(
        st.tuples(
            st.floats(0.0, 100.0),
            st.sampled_from(["wait", "fetch", "fetch", "rotate", "invalidate", "restart"]),
            st.integers(1, 4),
            st.floats(-20.0, 20.0),
        ),
        max_size=40,
    ),
)
def test_whatever_a_service_does_the_ring_stays_sound(
    past_keys: int, steps: list[tuple[float, str, int, float]]
) -> None:
    """A service that rotates, makes keys invalid and begins anew, heard with wrong times and at any time."""
    keyring = Keyring("t-1", past_keys)
    now, first, seed = 0.0, 1, 0
    before: int | None = None
    for wait, what, count, error in steps:
        now += wait
        if what == "rotate":
            first += 1
        elif what == "invalidate":
            first += 10
        elif what == "restart":
            first, seed = 1, seed + 1
        elif what == "fetch":
            keyring.advance(now)
            known = keyring.tokens.get(first)
            is_replaced = known is None or not known.is_key(key_data(first, seed))
            keyring.install(group_keys(first, count, seed=seed, next_s=30.0 + error), now)
            if is_replaced:
                before = None
        token = keyring.sending(now)
        if token is None:
            assert keyring.is_wanted(now)
            assert keyring.tokens == {}
            before = None
            continue
        assert keyring.tokens[token.token_id] is token, "readers take what publishers send"
        assert token in keyring.around_current()
        assert before is None or token.token_id >= before, "never back to an earlier key"
        assert keyring.changes_at > now
        assert all(known.until > now for known in keyring.tokens.values())
        assert all(token_id == known.token_id for token_id, known in keyring.tokens.items())
        before = token.token_id


def test_a_token_that_is_over_is_told_from_one_that_is_yet_to_come() -> None:
    keyring = ring(group_keys(7, 3, next_s=10.0))
    assert [keyring.is_over(token) for token in (1, 6, 7, 9, 10, 500)] == [True, True, False, False, False, False]
    first = ring(group_keys(1, 3))
    assert first.is_over(MAX_TOKEN_ID), "after the last one comes 1"
    assert not Keyring("t-1").is_over(6), "nobody knows without keys"
