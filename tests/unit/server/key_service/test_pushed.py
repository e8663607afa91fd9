"""Keys that were pushed: which are taken, which are given on, and for how long."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.server.key_service.fleet import fleet
from ua_fleet.errors import UaFleetError
from ua_fleet.pubsub.security.keyring import MAX_TOKEN_ID
from ua_fleet.server.key_service.pushed import KeysNotPushed, Push, PushedKeys, PushRefused
from ua_fleet.server.key_service.service import KeyService, TooManyKeyCalls
from ua_fleet.server.key_service.store import GroupSettings, GroupState, GroupUnknown
from ua_fleet.wire.security import SecurityPolicy

NOW = 1_700_000_000.0
LIFETIME = 100.0
POLICY = SecurityPolicy.AES256_CTR
SETTINGS = {"t-2": GroupSettings(POLICY, 3600.0, max_future_keys=4, max_past_keys=1)}


def key(token: int) -> bytes:
    return token.to_bytes(POLICY.key_data_bytes, "big")


def push(first: int = 5, count: int = 3, **changes: Any) -> Push:
    keys = tuple([key(first + index) for index in range(count)])
    return Push("t-2", POLICY.value, first, keys, 40.0, LIFETIME)._replace(**changes)


class Desk:
    """A store with a disk that can fail."""

    def __init__(self) -> None:
        self.disk: Mapping[str, GroupState] = {}
        self.full = False
        self.store = self.restart()

    def save(self, groups: Mapping[str, GroupState]) -> None:
        if self.full:
            raise OSError("no space left")
        self.disk = dict(groups)

    def restart(self) -> PushedKeys:
        self.store = PushedKeys(SETTINGS, self.disk, save=self.save)
        return self.store

    def given(self, now: float, start: int = 0, count: int = 5) -> tuple[int, list[int], float]:
        keys = self.store.get_keys("t-2", start, count, now)
        assert (keys.policy, keys.key_lifetime_s) == (POLICY, LIFETIME)
        return keys.first_token_id, [int.from_bytes(data, "big") for data in keys.keys], keys.time_to_next_key_s


@pytest.mark.parametrize("restart", [False, True])
def test_the_current_key_follows_the_time(restart: bool) -> None:
    desk = Desk()
    desk.store.push(push(), NOW)
    if restart:
        desk.restart()
    assert desk.given(NOW) == (5, [5, 6, 7], 40.0)
    assert desk.given(NOW + 39) == (5, [5, 6, 7], 1.0)
    assert desk.given(NOW + 40) == (6, [6, 7], 100.0)
    assert desk.given(NOW + 40, start=5, count=1) == (5, [5], 100.0)
    assert desk.given(NOW + 145) == (7, [7], 95.0)
    assert desk.given(NOW + 439) == (7, [7], 0.0)
    with pytest.raises(KeysNotPushed):
        desk.given(NOW + 440)
    assert desk.given(NOW - 1_000) == (5, [5, 6, 7], LIFETIME)  # the clock was put back


def test_past_keys_stay_where_a_push_continues_what_was_known() -> None:
    desk = Desk()
    desk.store.push(push(), NOW)
    desk.store.push(push(7, 2), NOW + 150)
    assert desk.given(NOW + 150) == (7, [7, 8], 40.0)
    assert desk.given(NOW + 150, start=6) == (6, [6, 7, 8], 40.0)
    assert desk.given(NOW + 150, start=5) == (6, [6, 7, 8], 40.0)  # only one past key is kept


@pytest.mark.parametrize("other", [push(50, 2), push(1, 1), push(6, 1, keys=(key(99),))])
def test_nothing_stays_of_what_was_known_where_the_service_began_anew(other: Push) -> None:
    desk = Desk()
    desk.store.push(push(), NOW)
    desk.store.push(other, NOW)
    token, keys, _ = desk.given(NOW, start=5)
    assert (token, len(keys)) == (other.current_token_id, len(other.keys))


def test_tokens_go_on_from_one() -> None:
    desk = Desk()
    desk.store.push(push(MAX_TOKEN_ID, 2), NOW)
    assert desk.given(NOW + 50)[0] == 1
    desk.store.push(push(1, 1, keys=(key(MAX_TOKEN_ID + 1), key(9))), NOW + 50)
    assert desk.given(NOW + 50, start=MAX_TOKEN_ID)[0] == MAX_TOKEN_ID


REFUSED: dict[str, tuple[dict[str, Any], int]] = {
    "another group": ({"group_id": "t-9"}, 0x803E_0000),
    "a null group": ({"group_id": ""}, 0x803E_0000),
    "another policy": ({"policy_uri": SecurityPolicy.AES128_CTR.value}, 0x8055_0000),
    "no policy": ({"policy_uri": ""}, 0x8055_0000),
    "token 0": ({"current_token_id": 0}, 0x80AB_0000),
    "no key": ({"keys": (None,)}, 0x80AB_0000),
    "an empty key": ({"keys": (b"",)}, 0x80AB_0000),
    "a key of 52 bytes": ({"keys": (bytes(52),)}, 0x80AB_0000),
    "a long future key": ({"keys": (key(1), bytes(69))}, 0x80AB_0000),
    "one key twice": ({"keys": (key(1), key(2), key(1))}, 0x80AB_0000),
    "too many keys": ({"keys": tuple([key(index) for index in range(257)])}, 0x80AB_0000),
    "a lifetime of 0": ({"key_lifetime_s": 0.0, "time_to_next_key_s": 0.0}, 0x80AB_0000),
    "a lifetime of 300 years": ({"key_lifetime_s": 1e10}, 0x80AB_0000),
    "a lifetime of NaN": ({"key_lifetime_s": math.nan}, 0x80AB_0000),
    "a time of NaN": ({"time_to_next_key_s": math.nan}, 0x80AB_0000),
    "a time of infinity": ({"time_to_next_key_s": math.inf}, 0x80AB_0000),
    "a time in the past": ({"time_to_next_key_s": -1.0}, 0x80AB_0000),
    "a time beyond the lifetime": ({"time_to_next_key_s": 100.5}, 0x80AB_0000),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_changes_nothing(name: str) -> None:
    changes, status = REFUSED[name]
    desk = Desk()
    desk.store.push(push(), NOW)
    before = dict(desk.disk)
    with pytest.raises((PushRefused, GroupUnknown)) as caught:
        desk.store.push(push(6, **changes), NOW)
    assert caught.value.ua_status == status
    assert desk.disk == before
    assert desk.given(NOW)[0] == 5


def test_what_cannot_be_written_down_does_not_count() -> None:
    desk = Desk()
    desk.full = True
    with pytest.raises(OSError, match="no space"):
        desk.store.push(push(), NOW)
    with pytest.raises(KeysNotPushed):
        desk.given(NOW)


def test_kept_keys_of_another_policy_do_not_count() -> None:
    kept = {"t-2": GroupState(SecurityPolicy.AES128_CTR, LIFETIME, 5, (bytes(52),), 0, NOW)}
    with pytest.raises(KeysNotPushed):
        PushedKeys(SETTINGS, kept, save=lambda _groups: None).get_keys("t-2", 0, 1, NOW)


def test_nothing_shows_a_key() -> None:
    assert "00000" not in repr(push()) + str(push())


@given(
    pushes=st.lists(st.tuples(st.integers(1, 9), st.integers(1, 6), st.floats(0, LIFETIME)), min_size=1, max_size=5),
    after=st.floats(-500, 2_000),
    start=st.integers(0, 12),
    count=st.integers(0, 8),
)
def test_no_token_is_ever_given_with_another_key(
    pushes: list[tuple[int, int, float]], after: float, start: int, count: int
) -> None:
    desk = Desk()
    for first, number, left in pushes:
        desk.store.push(push(first, number, time_to_next_key_s=left), NOW)
    try:
        token, keys, left = desk.given(NOW + after, start, count)
    except KeysNotPushed:
        assert after > 2 * LIFETIME
        return
    assert keys == list(range(token, token + len(keys)))
    assert keys
    assert 0 <= left <= LIFETIME


def test_the_service_gives_on_what_was_pushed_and_makes_none(tmp_path: Path) -> None:
    config = fleet(keys={"source": "pushed", "pushed_by": "sks"})
    wall = [NOW]
    service = KeyService(config, tmp_path, wall_s=lambda: wall[0])
    with pytest.raises(KeysNotPushed):
        service.keys_for_bridge("rover", "t-2", 0, 5)
    service.push(push())
    assert service.changes == 1
    assert service.keys_for_bridge("rover", "t-2", 0, 5).keys == (key(5), key(6), key(7))
    with pytest.raises(UaFleetError):
        service.keys_for_bridge("plc", "c-2", 0, 5)
    (file,) = tmp_path.iterdir()
    assert (file.name, file.stat().st_mode & 0o777) == ("pushed-keys.json", 0o600)
    again = KeyService(config, tmp_path, wall_s=lambda: wall[0])
    assert again.keys_for_bridge("rover", "t-2", 0, 5) == service.keys_for_bridge("rover", "t-2", 0, 5)


def test_nobody_pushes_without_end(tmp_path: Path) -> None:
    service = KeyService(fleet(keys={"source": "pushed", "pushed_by": "sks"}), tmp_path)

    def push_on() -> None:
        for _ in range(200):
            service.push(push())

    with pytest.raises(TooManyKeyCalls):
        push_on()
