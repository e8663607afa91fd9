from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.unit.server.key_service.fleet import fleet
from ua_fleet.endpoint.call_limit import LEAST_BURST
from ua_fleet.errors import KeySourceUnavailable, KeysRefused
from ua_fleet.server.key_service.files import GROUPS_FILE, KeysNotKept
from ua_fleet.server.key_service.local import LocalKeySource
from ua_fleet.server.key_service.service import KeysDenied, KeyService, TooManyKeyCalls
from ua_fleet.server.key_service.store import GroupUnknown
from ua_fleet.wire.security import SecurityPolicy


class Clock:
    def __init__(self) -> None:
        self.now = 1_700_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def service(tmp_path: Path, clock: Clock) -> KeyService:
    return KeyService(fleet(), tmp_path, wall_s=clock)


def test_settings_are_those_of_the_file(service: KeyService) -> None:
    settings = service.settings("t-2")
    assert (settings.policy, settings.lifetime_s) == (SecurityPolicy.AES256_CTR, 3600.0)
    assert (settings.max_future_keys, settings.max_past_keys) == (4, 1)
    assert service.group_ids == ("t-0", "t-1", "c-1", "t-2", "c-2", "t-300", "c-300")


def test_bridges_get_their_keys_and_no_others(service: KeyService) -> None:
    keys = service.keys_for_bridge("arm", "c-2", 0, 2)
    assert (keys.first_token_id, len(keys.keys)) == (1, 2)
    assert service.keys_for_bridge("rover", "c-2", 0, 2) == keys
    with pytest.raises(KeysDenied, match="bridge plc may not have the keys of c-2"):
        service.keys_for_bridge("plc", "c-2", 0, 2)
    with pytest.raises(GroupUnknown):
        service.keys_for_bridge("arm", "c-9", 0, 2)
    with pytest.raises(KeysDenied):
        service.keys_for_space(0, "c-300", 0, 1)


def test_a_restart_keeps_the_keys(service: KeyService, tmp_path: Path, clock: Clock) -> None:
    before = service.keys_for_bridge("arm", "t-1", 0, 5)
    clock.now += 3600
    again = KeyService(fleet(), tmp_path, wall_s=clock)
    after = again.keys_for_bridge("arm", "t-1", 0, 5)
    assert after.first_token_id == 2
    assert after.keys[:4] == before.keys[1:]


@pytest.mark.parametrize("step_s", [43_200.0, -43_200.0])
def test_a_wall_clock_that_is_set_makes_no_key_older(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step_s: float
) -> None:
    """Else the server has other keys than bridges, and drops what they send until they ask."""
    service = KeyService(fleet(), tmp_path)
    before = service.keys_for_bridge("arm", "t-1", 0, 5)
    set_to = time.time() + step_s
    monkeypatch.setattr(time, "time", lambda: set_to)
    after = service.keys_for_bridge("arm", "t-1", 0, 5)
    assert (after.first_token_id, after.keys) == (before.first_token_id, before.keys)


def test_who_asks_too_often_waits(service: KeyService) -> None:
    with pytest.raises(TooManyKeyCalls):
        [service.keys_for_bridge("arm", "t-1", 0, 1) for _ in range(2 * LEAST_BURST)]
    service.keys_for_bridge("rover", "t-1", 0, 1)
    for _ in range(2 * LEAST_BURST):
        service.keys_for_space(0, "t-1", 0, 1)


def test_changes_before_their_time_are_counted(service: KeyService, clock: Clock) -> None:
    source = LocalKeySource(service)
    clock.now += 1.0
    service.keys_for_space(0, "t-0", 0, 1)
    assert source.generation == 0
    service.rotate("t-0")
    assert service.keys_for_space(0, "t-0", 0, 1).first_token_id == 2
    service.invalidate("t-0")
    assert service.keys_for_space(0, "t-0", 0, 1).first_token_id == 7
    assert source.generation == 2


def test_a_disk_that_takes_nothing(service: KeyService, tmp_path: Path, clock: Clock) -> None:
    service.keys_for_space(0, "t-0", 0, 1)
    clock.now += 3600
    (tmp_path / GROUPS_FILE).unlink()
    tmp_path.rmdir()
    tmp_path.write_text("")
    with pytest.raises(KeysNotKept):
        service.keys_for_space(0, "t-0", 0, 1)


def test_many_threads_get_the_same_keys(service: KeyService, clock: Clock) -> None:
    clock.now += 3600
    found: list[tuple[bytes, ...]] = []
    ask: Callable[[], None] = lambda: found.append(service.keys_for_space(0, "t-0", 0, 5).keys)  # noqa: E731
    threads = [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert len(set(found)) == 1


async def test_the_servers_own_source(service: KeyService, tmp_path: Path, clock: Clock) -> None:
    source = LocalKeySource(service)
    assert await source.fetch("t-2", 0, 3) == service.keys_for_space(0, "t-2", 0, 3)
    for group in ("c-300", "t-9"):
        with pytest.raises(KeysRefused) as refused:
            await source.fetch(group, 0, 1)
        assert refused.value.group_id == group
    clock.now += 3600
    (tmp_path / GROUPS_FILE).unlink()
    tmp_path.rmdir()
    tmp_path.write_text("")
    with pytest.raises(KeySourceUnavailable, match="cannot be written"):
        await source.fetch("t-2", 0, 3)
