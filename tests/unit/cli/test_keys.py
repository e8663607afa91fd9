from __future__ import annotations

import json
import re
import time
from pathlib import Path
from typing import Any

import pytest

from tests.unit.cli.conftest import Invoke
from ua_fleet.storage.key_files import KeyFolder

FLEET = """\
version: 1
pubsub:
  security: sign_and_encrypt
  keys: {source: files, lifetime_s: 7200, policy: PubSub-Aes128-CTR}
bridges:
  cell: {kind: ros1, status_id: 1}
  floor: {kind: ros2, space: 7, status_id: 2}
"""
GROUPS = ["c-1", "c-7", "t-0", "t-1", "t-7"]


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    (tmp_path / "fleet.yaml").write_text(FLEET)
    return KeyFolder(tmp_path / "keys")


def objects(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def secrets_of(folder: KeyFolder) -> list[str]:
    return [key.key_data.hex() for group_id in folder.groups() for key in folder.read(group_id).keys]


def test_create_makes_what_is_missing_and_leaves_the_rest(invoke: Invoke, folder: KeyFolder) -> None:
    ended = invoke("keys", "create", "t-7")
    assert (ended.code, ended.stdout) == (0, f"t-7  {folder.path}/t-7.json\n")
    before = folder.read("t-7")
    assert (before.policy.short_name, before.lifetime_s) == ("PubSub-Aes128-CTR", 7200.0)
    ended = invoke("keys", "create", "--json")
    assert [made["group"] for made in objects(ended.stdout)] == ["t-0", "t-1", "c-1", "c-7"]
    assert folder.groups() == GROUPS
    assert folder.read("t-7") == before
    assert len(set(secrets_of(folder))) == 5
    ended = invoke("keys", "create")
    assert (ended.code, ended.stdout) == (0, "")
    assert ended.stderr == "nothing to do, all key files exist; new keys: ua-fleet keys rotate\n"


def test_rotate_gives_all_or_some_a_next_key(invoke: Invoke, folder: KeyFolder) -> None:
    invoke("keys", "create")
    ended = invoke("keys", "rotate")
    assert ended.code == 0
    assert re.fullmatch(r"(([ct]-[0-9])  token 2 from 20[-0-9T:]+Z on\n){5}", ended.stdout)
    ended = invoke("keys", "rotate", "t-1", "--after", "3600", "--json")
    (rotated,) = objects(ended.stdout)
    assert (rotated["group"], rotated["token"]) == ("t-1", 3)
    keys = folder.read("t-1").keys
    assert [key.token_id for key in keys] == [1, 2, 3]
    assert keys[1].active_from - time.time() <= 10
    assert keys[2].active_from - keys[1].active_from == 3600
    assert [key.token_id for key in folder.read("t-0").keys] == [1, 2]


def test_rotate_takes_the_lifetime_of_the_configuration(invoke: Invoke, folder: KeyFolder) -> None:
    invoke("keys", "create")
    path = folder.path.parent / "fleet.yaml"
    path.write_text(FLEET.replace("7200", "60"))
    invoke("keys", "rotate", "t-1")
    assert (folder.read("t-0").lifetime_s, folder.read("t-1").lifetime_s) == (7200.0, 60.0)


def test_rotate_without_end_is_refused(invoke: Invoke, folder: KeyFolder) -> None:
    invoke("keys", "create", "t-0")
    key_file = folder.read("t-0")
    for _ in range(99):
        key_file = key_file.rotated(time.time(), 10.0, 1)
    folder.write(key_file)
    ended = invoke("keys", "rotate", "t-0")
    assert ended.code == 2
    assert ended.stderr.endswith(
        "t-0.json: would have more than 100 keys; wait until the first of those to come is current\n"
    )
    assert len(folder.read("t-0").keys) == 100


def test_rotate_of_a_leaked_key_ends_the_old_ones(invoke: Invoke, folder: KeyFolder) -> None:
    invoke("keys", "create")
    invoke("keys", "rotate", "t-1", "--leaked")
    (key,) = folder.read("t-1").keys
    assert key.token_id == 2
    assert key.active_from <= time.time()


def test_list(invoke: Invoke, folder: KeyFolder) -> None:
    ended = invoke("keys", "list")
    assert (ended.code, ended.stdout) == (0, "")
    assert ended.stderr == "without a key file: t-0, t-1, c-1, t-7, c-7; make them with: ua-fleet keys create\n"
    invoke("keys", "create")
    invoke("keys", "rotate", "t-7", "--after", "86400")
    ended = invoke("keys", "list")
    assert (ended.code, ended.stderr) == (0, "")
    heading, *rows = ended.stdout.splitlines()
    assert heading.split("  ")[0] == "group"
    assert [row.split()[0] for row in rows] == GROUPS
    assert re.fullmatch(r"c-1 +PubSub-Aes128-CTR +\[1\] +\d s +due 20\S+Z +600", rows[0])
    assert re.fullmatch(r"t-7 +PubSub-Aes128-CTR +\[1\] 2 +\d s +at 20\S+Z +600", rows[4])
    shown = objects(invoke("keys", "list", "--json").stdout)
    assert shown[4] | {"age_s": 0, "next_key_at": "", "rotation_due_at": ""} == {
        "group": "t-7",
        "policy": "PubSub-Aes128-CTR",
        "past_tokens": [],
        "current_token": 1,
        "future_tokens": [2],
        "age_s": 0,
        "next_key_at": "",
        "rotation_due_at": "",
        "overdue": False,
        "rights": "600",
        "problem": None,
    }


def test_list_shows_what_is_overdue(invoke: Invoke, folder: KeyFolder) -> None:
    invoke("keys", "create", "t-0")
    path = folder.path_of("t-0")
    path.write_text(re.sub(r'"20\d\d-', '"2020-', path.read_text()))
    assert re.search(r"\[1\] +\d+ d +overdue since 2020-", invoke("keys", "list").stdout)
    assert objects(invoke("keys", "list", "--json").stdout)[0]["overdue"] is True


def test_a_file_that_must_not_be_used_is_listed_and_ends_with_the_remedy(invoke: Invoke, folder: KeyFolder) -> None:
    invoke("keys", "create")
    path = folder.path_of("t-1")
    path.chmod(0o644)
    for command in ("create", "rotate", "list"):
        ended = invoke("keys", command)
        assert ended.code == 2
        assert ended.stderr.endswith(f"{path}: others may read or write it (mode 644); run: chmod 600 {path}\n")
    assert re.search(r"^t-1 +others may read or write it \(mode 644\) +644$", ended.stdout, re.MULTILINE)
    assert [len(folder.read(group_id).keys) for group_id in GROUPS if group_id != "t-1"] == [1] * 4


@pytest.mark.parametrize("command", ["create", "rotate"])
@pytest.mark.parametrize("group", ["t-", "x-1", "t-70000", "t-01", "../t-1"])
def test_what_is_no_group(invoke: Invoke, folder: KeyFolder, command: str, group: str) -> None:
    invoke("keys", "create")
    ended = invoke("keys", command, "--", group)
    assert ended.code == 2
    assert ended.stderr.endswith(
        f"{group!r} is no SecurityGroup; name one like t-2 (data of space 2), c-2 (its commands) or r-gate (a relay)\n"
    )


def test_rotate_what_is_not_there(invoke: Invoke, folder: KeyFolder) -> None:
    ended = invoke("keys", "rotate")
    assert (ended.code, ended.stdout) == (3, "")
    assert ended.stderr.endswith(f"there are no key files in {folder.path}; make them with: ua-fleet keys create\n")
    invoke("keys", "create", "t-0")
    ended = invoke("keys", "rotate", "t-0", "t-1")
    assert ended.code == 3
    assert ended.stderr.endswith("t-1.json: there is no such key file; run: ua-fleet keys create t-1\n")
    assert len(folder.read("t-0").keys) == 1


def test_who_does_not_use_the_files_is_told(invoke: Invoke, folder: KeyFolder) -> None:
    path = folder.path.parent / "fleet.yaml"
    path.write_text(FLEET.replace("source: files, ", ""))
    said = "fleet.yaml takes keys from the service; for these files write pubsub.keys.source: files\n"
    assert invoke("keys", "create").stderr == said
    path.write_text(FLEET.replace("sign_and_encrypt", "none"))
    assert invoke("keys", "list").stderr == "fleet.yaml has pubsub.security: none, so no process uses these files\n"


def test_no_command_shows_a_key(invoke: Invoke, folder: KeyFolder) -> None:
    said = ""
    for arguments in (["create"], ["rotate"], ["list"], ["list", "--json"], ["rotate", "--json", "--leaked"]):
        ended = invoke("keys", *arguments)
        said += ended.stdout + ended.stderr
        assert not any(secret[:16] in said for secret in secrets_of(folder))
    folder.path_of("t-0").write_text('{"key": "' + "5e" * 68)
    for command in ("create", "rotate", "list"):
        ended = invoke("keys", command)
        assert ended.code == 2
        assert "5e5e" not in ended.stdout + ended.stderr


def test_a_bridge_without_its_key_files_does_not_start(invoke: Invoke, folder: KeyFolder) -> None:
    ended = invoke("bridge", "floor")
    assert ended.code == 2
    assert ended.stderr.endswith(
        f"{folder.path}: cannot be entered: no such file or directory; run: ua-fleet keys create\n"
    )
    invoke("keys", "create", "t-0")
    ended = invoke("bridge", "floor")
    assert ended.code == 2
    assert ended.stderr.endswith("t-7.json: there is no such key file; run: ua-fleet keys create t-7\n")
    invoke("keys", "create", "t-7")
    folder.path_of("t-0").chmod(0o640)
    ended = invoke("bridge", "floor")
    assert ended.code == 2
    assert ended.stderr.endswith(f"run: chmod 600 {folder.path_of('t-0')}\n")


def test_a_server_without_its_key_files_does_not_start(invoke: Invoke, folder: KeyFolder) -> None:
    ended = invoke("serve", "--port", "0")
    assert ended.code == 2
    assert ended.stderr.endswith(
        f"{folder.path}: cannot be entered: no such file or directory; run: ua-fleet keys create\n"
    )
