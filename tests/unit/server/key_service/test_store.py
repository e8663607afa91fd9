from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ua_fleet.pubsub.security.keyring import GroupKeys
from ua_fleet.server.key_service.store import (
    MAX_TOKEN_ID,
    GroupSettings,
    GroupState,
    GroupUnknown,
    KeyStore,
)
from ua_fleet.values import StatusCode
from ua_fleet.wire.security import SecurityPolicy

LIFETIME = 3600.0
YEAR = 365 * 24 * 3600.0
START = 1_700_000_000.0
SETTINGS = GroupSettings(SecurityPolicy.AES256_CTR, LIFETIME, max_future_keys=4, max_past_keys=1)


def numbered() -> Callable[[int], bytes]:
    """Random bytes that are a number, so that each key is another one and can be told from the others."""
    numbers = itertools.count(1)
    return lambda size: next(numbers).to_bytes(size, "big")


class Bench:
    """A store with a disk that can fail, and all keys that it has ever handed out."""

    def __init__(self, settings: GroupSettings = SETTINGS, *groups: str, start: float = START) -> None:
        self.settings = dict.fromkeys(groups or ("t-2",), settings)
        self.disk: Mapping[str, GroupState] = {}
        self.full = False
        self.saves = 0
        self.token_bytes = numbered()
        self.given: dict[tuple[str, int], bytes] = {}
        self.now = start
        self.store = self.restart()

    def save(self, groups: Mapping[str, GroupState]) -> None:
        if self.full:
            raise OSError("no space left")
        self.saves += 1
        self.disk = dict(groups)

    def restart(self, settings: GroupSettings | None = None) -> KeyStore:
        if settings is not None:
            self.settings = dict.fromkeys(self.settings, settings)
        self.store = KeyStore(self.settings, self.disk, now=self.now, token_bytes=self.token_bytes, save=self.save)
        return self.store

    def get(self, start: int = 0, count: int = 5, group: str = "t-2") -> GroupKeys:
        """Keys; no token is ever given to two of them, and all that is given stands on the disk."""
        keys = self.store.get_keys(group, start, count, self.now)
        for step, key in enumerate(keys.keys):
            token = (keys.first_token_id - 1 + step) % MAX_TOKEN_ID + 1
            assert self.given.setdefault((group, token), key) == key
            assert key in self.disk[group].keys
        return keys


def test_a_new_group_begins_with_token_1() -> None:
    bench = Bench()
    keys = bench.get()
    assert (keys.first_token_id, len(keys.keys)) == (1, 5)
    assert keys.policy is SecurityPolicy.AES256_CTR
    assert (keys.time_to_next_key_s, keys.key_lifetime_s) == (LIFETIME, LIFETIME)
    assert {len(key) for key in keys.keys} == {68}


def test_the_token_moves_on_by_one_each_lifetime_though_nobody_asks() -> None:
    bench = Bench()
    first = bench.get()
    bench.now += 2.25 * LIFETIME
    keys = bench.get()
    assert keys.first_token_id == 3
    assert keys.time_to_next_key_s == pytest.approx(0.75 * LIFETIME)
    assert keys.keys[:3] == first.keys[2:]
    assert bench.store.current_token_id("t-2", bench.now) == 3


def test_years_without_a_question() -> None:
    bench = Bench()
    bench.get()
    bench.now += 3 * YEAR
    assert bench.get().first_token_id == 1 + int(3 * YEAR // LIFETIME)
    assert len(bench.disk["t-2"].keys) == 5


def test_years_with_questions() -> None:
    bench = Bench()
    for hour in range(24 * 400):
        bench.now = START + hour * LIFETIME
        assert bench.get().first_token_id == hour + 1
    assert len(bench.disk["t-2"].keys) == 6


def test_past_keys_are_kept_as_many_as_are_wanted() -> None:
    bench = Bench(replace(SETTINGS, max_past_keys=2))
    first = bench.get()
    bench.now += 3.5 * LIFETIME
    past = bench.get(start=2)
    assert past.first_token_id == 2
    assert past.keys[0] == first.keys[1]
    assert len(past.keys) == 5


def test_an_unknown_starting_token_is_the_oldest_there_is() -> None:
    bench = Bench()
    bench.now += 3 * LIFETIME
    for unknown in (1, 2, 9, 4_000_000_000):
        assert bench.get(start=unknown).first_token_id == bench.get(start=3).first_token_id
    assert bench.get(start=8).first_token_id == 8


@pytest.mark.parametrize(("count", "given"), [(0, 1), (1, 1), (3, 3), (5, 5), (6, 5), (0xFFFF_FFFF, 5)])
def test_counts_are_limited(count: int, given: int) -> None:
    assert len(Bench().get(count=count).keys) == given


def test_from_a_past_token_there_is_one_key_more() -> None:
    bench = Bench()
    bench.now += LIFETIME
    assert len(bench.get(start=1, count=100).keys) == 6
    assert len(bench.get(start=1, count=0).keys) == 1


def test_tokens_wrap_to_1() -> None:
    bench = Bench()
    state = replace(bench.disk["t-2"], first_token_id=MAX_TOKEN_ID - 1)
    bench.disk = {"t-2": state}
    bench.restart()
    assert bench.get().first_token_id == MAX_TOKEN_ID - 1
    bench.now += LIFETIME
    assert bench.get().first_token_id == MAX_TOKEN_ID
    bench.now += LIFETIME
    assert bench.get().first_token_id == 1
    assert bench.get(start=MAX_TOKEN_ID).first_token_id == MAX_TOKEN_ID
    assert bench.get(start=3).first_token_id == 3
    bench.now += 10 * LIFETIME
    assert bench.get().first_token_id == 11
    bench.store.invalidate("t-2", bench.now)
    assert bench.get().first_token_id == 16


def test_invalidate_goes_beyond_the_last_future_key() -> None:
    bench = Bench()
    bench.now += 2.5 * LIFETIME
    before = bench.get(start=2, count=10)
    bench.store.invalidate("t-2", bench.now)
    after = bench.get()
    assert after.first_token_id == 8
    assert after.time_to_next_key_s == LIFETIME
    assert not set(before.keys) & set(after.keys)
    # The past key is gone too: with a gap in the tokens it could not be handed out.
    assert bench.get(start=2).first_token_id == 8


def test_rotate_makes_the_next_key_current() -> None:
    bench = Bench()
    before = bench.get()
    bench.now += 10.0
    bench.store.rotate("t-2", bench.now)
    after = bench.get()
    assert after.first_token_id == 2
    assert after.keys[:4] == before.keys[1:]
    assert after.time_to_next_key_s == LIFETIME
    assert bench.get(start=1).keys[0] == before.keys[0]


def test_groups_do_not_touch_each_other() -> None:
    bench = Bench(SETTINGS, "t-0", "t-2", "c-2")
    assert bench.store.group_ids == ("t-0", "t-2", "c-2")
    bench.store.rotate("t-2", bench.now)
    bench.store.invalidate("c-2", bench.now)
    assert [bench.get(group=group).first_token_id for group in bench.store.group_ids] == [1, 2, 6]
    keys = [key for group in bench.store.group_ids for key in bench.get(group=group).keys]
    assert len(set(keys)) == len(keys)


def test_one_save_for_all_groups_that_are_due() -> None:
    bench = Bench(SETTINGS, *(f"t-{space}" for space in range(20)))
    assert bench.saves == 1
    bench.now += LIFETIME
    bench.get(group="t-0")
    assert bench.saves == 2
    for space in range(20):
        bench.get(group=f"t-{space}")
    assert bench.saves == 2


@pytest.mark.parametrize("group", ["", "t-9", "x" * 10_000])
def test_unknown_groups(group: str) -> None:
    store = Bench().store
    calls: list[Callable[[], Any]] = [
        lambda: store.get_keys(group, 0, 1, START),
        lambda: store.invalidate(group, START),
        lambda: store.rotate(group, START),
        lambda: store.settings(group),
        lambda: store.current_token_id(group, START),
    ]
    for call in calls:
        with pytest.raises(GroupUnknown) as refused:
            call()
        assert refused.value.ua_status == StatusCode.BAD_NOT_FOUND
        assert len(str(refused.value)) < 200


def test_a_restart_goes_on_with_the_same_keys() -> None:
    bench = Bench()
    before = bench.get()
    bench.now += 1.5 * LIFETIME
    bench.restart()
    after = bench.get()
    assert after.first_token_id == 2
    assert after.keys[:4] == before.keys[1:]


@pytest.mark.parametrize("future", [1, 2, 4])
def test_a_service_that_is_restarted_over_and_over_keeps_its_pace(future: int) -> None:
    bench = Bench(replace(SETTINGS, max_future_keys=future))
    for _ in range(40):
        bench.now += 0.2 * LIFETIME
        bench.restart()
    assert bench.get().first_token_id == pytest.approx(1 + 8, abs=1)


def test_more_or_fewer_keys_after_a_restart() -> None:
    bench = Bench()
    before = bench.get()
    bench.restart(replace(SETTINGS, max_future_keys=1, max_past_keys=0))
    fewer = bench.get()
    assert fewer.keys == before.keys[:2]
    bench.now += LIFETIME
    assert bench.get(start=1).first_token_id == 2
    bench.restart(replace(SETTINGS, max_future_keys=9))
    more = bench.get(count=100)
    assert (more.first_token_id, len(more.keys)) == (2, 10)
    assert more.keys[:4] == before.keys[1:]


@pytest.mark.parametrize(
    "changed", [replace(SETTINGS, lifetime_s=60.0), replace(SETTINGS, policy=SecurityPolicy.AES128_CTR)]
)
def test_another_policy_or_lifetime_makes_all_keys_invalid(changed: GroupSettings) -> None:
    bench = Bench()
    bench.get()
    bench.restart(changed)
    keys = bench.get()
    assert keys.first_token_id == 6
    assert {len(key) for key in keys.keys} == {changed.policy.key_data_bytes}


def test_a_group_that_comes_back_does_not_use_its_tokens_again() -> None:
    bench = Bench(SETTINGS, "t-0", "t-2")
    bench.get()
    everything = bench.settings
    bench.settings = {"t-0": SETTINGS}
    bench.restart()
    with pytest.raises(GroupUnknown):
        bench.get()
    bench.settings = everything
    bench.now += 100 * LIFETIME
    bench.restart()
    assert bench.get().first_token_id == 101


def test_what_cannot_be_saved_is_not_handed_out() -> None:
    bench = Bench()
    before = bench.get()
    bench.now += LIFETIME
    bench.full = True
    for call in (bench.get, lambda: bench.store.rotate("t-2", bench.now), lambda: bench.store.invalidate("t-2", 0.0)):
        with pytest.raises(OSError, match="no space"):
            call()
    bench.full = False
    keys = bench.get()
    assert keys.first_token_id == 2
    assert keys.keys[:4] == before.keys[1:]


def test_a_clock_that_is_put_back_never_takes_a_token_back() -> None:
    bench = Bench()
    bench.now += 10 * LIFETIME
    assert bench.get().first_token_id == 11
    bench.now -= 5 * YEAR
    keys = bench.get()
    assert (keys.first_token_id, keys.time_to_next_key_s) == (11, LIFETIME)
    bench.now += LIFETIME
    assert bench.get().first_token_id == 12
    # A small step of a clock that is being set is no reason to write.
    saves = bench.saves
    bench.now -= 0.5
    assert bench.get().time_to_next_key_s == LIFETIME
    assert bench.saves == saves


def test_no_key_is_shown() -> None:
    bench = Bench()
    keys = bench.get()
    shown = f"{keys!r} {keys} {bench.disk!r} {bench.store!r} {vars(bench.store)!r}"
    for key in keys.keys:
        assert key.hex() not in shown
        assert repr(key) not in shown


@given(
    steps=st.lists(
        st.one_of(
            st.tuples(st.just("pass"), st.floats(-2 * LIFETIME, 12 * LIFETIME)),
            st.tuples(st.sampled_from(["rotate", "invalidate", "restart"]), st.just(0.0)),
            st.tuples(st.just("ask"), st.integers(0, 12)),
        ),
        max_size=30,
    ),
    past=st.integers(0, 3),
    future=st.integers(1, 5),
    first=st.sampled_from([1, MAX_TOKEN_ID - 3]),
)
def test_no_token_is_ever_given_to_two_keys(steps: list[tuple[str, float]], past: int, future: int, first: int) -> None:
    bench = Bench(replace(SETTINGS, max_past_keys=past, max_future_keys=future))
    bench.disk = {"t-2": replace(bench.disk["t-2"], first_token_id=first)}
    bench.restart()
    last = bench.get()
    for what, argument in steps:
        if what == "pass":
            bench.now += argument
        elif what == "restart":
            bench.restart()
        elif what == "ask":
            bench.get(start=int(argument))
        else:
            getattr(bench.store, what)("t-2", bench.now)
        keys = bench.get(count=100)
        assert len(keys.keys) == future + 1
        assert (keys.first_token_id - last.first_token_id) % MAX_TOKEN_ID < MAX_TOKEN_ID // 2
        assert 0 <= keys.time_to_next_key_s <= LIFETIME
        assert len(bench.disk["t-2"].keys) <= past + 1 + future
        last = keys
