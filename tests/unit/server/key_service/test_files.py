from __future__ import annotations

import json
import os
import secrets
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.errors import ServerStartError
from ua_fleet.server.key_service.files import GROUPS_FILE, KeysNotKept, load_groups, save_groups
from ua_fleet.server.key_service.store import GroupState
from ua_fleet.wire.security import SecurityPolicy

KEYS = tuple(secrets.token_bytes(52) for _ in range(3))
STATE = GroupState(SecurityPolicy.AES128_CTR, 60.0, 4_294_967_295, KEYS, 1, 1_700_000_000.125)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / GROUPS_FILE
    save_groups(path, {"t-2": STATE})
    return path


def test_what_is_saved_is_loaded(path: Path) -> None:
    assert load_groups(path) == {"t-2": STATE}
    assert path.stat().st_mode & 0o777 == 0o600
    assert [entry.name for entry in path.parent.iterdir()] == [GROUPS_FILE]


def test_no_file_is_no_groups(tmp_path: Path) -> None:
    assert load_groups(tmp_path / GROUPS_FILE) == {}


def test_a_file_that_others_can_read_is_refused(path: Path) -> None:
    path.chmod(0o640)
    with pytest.raises(ServerStartError, match=f"chmod 600 {path}"):
        load_groups(path)


def test_a_file_of_another_user_is_refused(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if os.geteuid() == 0:
        os.chown(path, 12_345, -1)
    else:
        monkeypatch.setattr("os.geteuid", lambda: path.stat().st_uid + 1)
    with pytest.raises(ServerStartError, match="another user"):
        load_groups(path)


def broken(**changes: Any) -> str:
    entry = {
        "policy": "PubSub-Aes128-CTR",
        "lifetime_s": 60.0,
        "first_token": 1,
        "current": 0,
        "since": 0.0,
        "keys": [KEYS[0].hex()],
        **changes,
    }
    return json.dumps({"version": 1, "groups": {"t-2": entry}})


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "{",
        "null",
        '{"version": 0, "groups": {}}',
        '{"version": 1, "groups": [1]}',
        "[" * 100_000,
        broken(policy="None"),
        broken(keys=[]),
        broken(keys=[KEYS[0].hex()[2:]]),
        broken(keys=["secret" + KEYS[0].hex()]),
        broken(current=1),
        broken(current=-1),
        broken(first_token=0),
        broken(first_token=2**32),
        broken(lifetime_s=0),
        broken(lifetime_s=float("nan")),
        broken(since=float("inf")),
    ],
)
def test_broken_files_are_one_line_without_a_key(path: Path, content: str) -> None:
    path.write_text(content)
    with pytest.raises(ServerStartError) as refused:
        load_groups(path)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)
    assert KEYS[0].hex()[4:20] not in f"{refused.value!r}{refused.value.__cause__!r}"
    assert refused.value.__suppress_context__


def test_a_disk_that_does_not_take_it(tmp_path: Path) -> None:
    folder = tmp_path / "is_a_file"
    folder.write_text("")
    with pytest.raises(KeysNotKept, match="cannot be written") as refused:
        save_groups(folder / GROUPS_FILE, {"t-2": STATE})
    assert KEYS[0].hex()[:16] not in str(refused.value)
