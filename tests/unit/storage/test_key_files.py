from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from ua_fleet.errors import ConfigError
from ua_fleet.storage.key_files import MAX_TOKEN_ID, FileKey, KeyFile, KeyFolder, NoKeyFile
from ua_fleet.wire.security import SecurityPolicy

AES128, AES256 = SecurityPolicy.AES128_CTR, SecurityPolicy.AES256_CTR
NOW = 1_800_000_000.0


@pytest.fixture
def folder(tmp_path: Path) -> KeyFolder:
    return KeyFolder(tmp_path / "keys")


def made(folder: KeyFolder, group_id: str = "t-2", policy: SecurityPolicy = AES256) -> KeyFile:
    key_file = KeyFile.new(group_id, policy, 3600.0, NOW)
    folder.write(key_file)
    return key_file


def mode_of(path: Path) -> int:
    return path.stat().st_mode & 0o777


@pytest.mark.parametrize("policy", SecurityPolicy)
def test_what_was_written_is_read(folder: KeyFolder, policy: SecurityPolicy) -> None:
    key_file = made(folder, policy=policy).rotated(NOW + 5.5, 10.0, 1)
    folder.write(key_file)
    assert folder.read("t-2") == key_file
    assert [len(key.key_data) for key in key_file.keys] == [policy.key_data_bytes] * 2
    assert key_file.keys[0].key_data != key_file.keys[1].key_data
    assert folder.groups() == ["t-2"]


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_only_the_owner_may_read_what_is_made(folder: KeyFolder, umask: int) -> None:
    before = os.umask(umask)
    try:
        made(folder)
    finally:
        os.umask(before)
    assert (mode_of(folder.path), mode_of(folder.path_of("t-2"))) == (0o700, 0o600)
    assert [path.name for path in folder.path.iterdir()] == ["t-2.json"]


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o610, 0o666])
def test_a_file_that_others_may_use_is_refused(folder: KeyFolder, mode: int) -> None:
    made(folder)
    path = folder.path_of("t-2")
    path.chmod(mode)
    with pytest.raises(ConfigError) as caught:
        folder.read("t-2")
    assert str(caught.value) == f"{path}: others may read or write it (mode {mode:o}); run: chmod 600 {path}"
    path.chmod(0o400)
    assert folder.read("t-2").group_id == "t-2"


@pytest.mark.parametrize("mode", [0o750, 0o705, 0o777])
def test_a_folder_that_others_may_enter_is_refused(folder: KeyFolder, mode: int) -> None:
    key_file = made(folder)
    folder.path.chmod(mode)
    message = f"{folder.path}: others may read or write it (mode {mode:o}); run: chmod 700 {folder.path}"
    uses: list[Callable[[], object]] = [
        lambda: folder.read("t-2"),
        lambda: folder.stamp("t-2"),
        lambda: folder.write(key_file),
        folder.groups,
        folder.exclusive().__enter__,
    ]
    for use in uses:
        with pytest.raises(ConfigError, match=re.escape(message)):
            use()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_a_file_of_another_user_is_refused_and_one_of_root_is_not(folder: KeyFolder) -> None:
    made(folder)
    path = folder.path_of("t-2")
    os.chown(path, 4711, 4711)
    with pytest.raises(ConfigError, match="belongs to another user; run: chown 0 "):
        folder.read("t-2")


def test_what_is_not_there(folder: KeyFolder) -> None:
    assert folder.groups() == []
    with pytest.raises(ConfigError, match="cannot be entered: no such file or directory; run: ua-fleet keys create"):
        folder.read("t-2")
    made(folder)
    with pytest.raises(NoKeyFile) as caught:
        folder.read("c-3")
    path = folder.path_of("c-3")
    assert str(caught.value) == f"{path}: there is no such key file; run: ua-fleet keys create c-3"
    with pytest.raises(NoKeyFile):
        folder.stamp("c-3")


@pytest.mark.parametrize("group_id", ["", "..", "../t-2", "t-2/x", ".t-2", "t 2", "t-2\n", "ü", "x" * 65])
def test_a_group_never_leads_out_of_the_folder(folder: KeyFolder, group_id: str) -> None:
    with pytest.raises(ConfigError, match="is no name of a SecurityGroup"):
        folder.path_of(group_id)


LONG = "5e" * 68
GOOD = f"""\
{{"version": 1, "group": "t-2", "policy": "PubSub-Aes256-CTR", "lifetime_s": 60, "keys": [
  {{"token": 7, "created": "2027-01-15T08:00:00Z", "active_from": "2027-01-15T08:00:00Z", "key": "{LONG}"}},
  {{"token": 8, "created": "2027-01-15T08:30:00.500Z", "active_from": "2027-01-15T10:31:00+01:00",
   "key": "{"0" * 135}1"}}
]}}
"""


def put(folder: KeyFolder, content: str | bytes) -> None:
    folder.path.mkdir(mode=0o700, exist_ok=True)
    path = folder.path_of("t-2")
    path.touch(mode=0o600)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())


def test_a_file_that_people_wrote(folder: KeyFolder) -> None:
    put(folder, GOOD)
    key_file = folder.read("t-2")
    assert key_file.keys == (
        FileKey(7, NOW, NOW, b"\x5e" * 68),
        FileKey(8, NOW + 1800.5, NOW + 5460.0, bytes(67) + b"\x01"),
    )


BROKEN: list[tuple[str, Callable[[str], str | bytes], str]] = [
    ("empty", lambda _: "", ":1: cannot be read as JSON; take it from a backup"),
    ("a text", lambda _: f'"{LONG}"', ": is no key file; move it away and run: ua-fleet keys create t-2"),
    ("no JSON", lambda text: text + LONG, ":6: cannot be read as JSON; take it from a backup"),
    ("no UTF-8", lambda text: text.encode() + b"\xff" + LONG.encode(), ": cannot be read as JSON"),
    ("nested", lambda _: "[" * 200_000, ": cannot be read as JSON"),
    ("large", lambda text: text + " " * 300_000, ": is larger than 256 KiB"),
    ("a long number", lambda text: text.replace(": 60", ": " + "7" * 9000), ": cannot be read as JSON"),
    ("version", lambda text: text.replace('n": 1', 'n": 0'), ":version: this ua-fleet reads version 1 of key files"),
    ("another group's", lambda text: text.replace("t-2", "t-3"), ":group: the file is not that of t-2; put the"),
    ("policy", lambda text: text.replace("Aes256-CTR", LONG), ":policy: is no policy of PubSub; allowed: PubSub-"),
    ("no policy", lambda text: text.replace("policy", "police"), ":policy: is missing; take the file from a backup"),
    (
        "a key too many",
        lambda text: f'{{"{LONG}": 1, {text[1:]}',
        ": has other keys than version, group, policy, lifet",
    ),
    ("lifetime 0", lambda text: text.replace(": 60", ": 0"), ":lifetime_s: must be a number of seconds above 0"),
    ("lifetime nan", lambda text: text.replace(": 60", ": NaN"), ":lifetime_s: must be a number of seconds above 0"),
    ("lifetime", lambda text: text.replace(": 60", f': "{LONG}"'), ":lifetime_s: must be a number of seconds above 0"),
    ("no keys", lambda text: text.partition("[")[0] + "[]}", ":keys: must be a list of 1 to 100 keys"),
    ("keys is a key", lambda text: text.partition("[")[0] + f'"{LONG}"}}', ":keys: must be a list of 1"),
    ("a key is a text", lambda text: text.replace("]", f', "{LONG}"]'), ":keys[2]: must have token, created, active_"),
    ("token 0", lambda text: text.replace(": 7", ": 0"), ":keys[0].token: must be a whole number, 1 to 4294967295"),
    ("token true", lambda text: text.replace(": 7", ": true"), ":keys[0].token: must be a whole number, 1 to 42949"),
    ("token large", lambda text: text.replace(": 8", ": 4294967296"), ":keys[1].token: must be a whole number"),
    ("token is the key", lambda text: text.replace(": 7", f': "{LONG}"'), ":keys[0].token: must be a whole number"),
    ("token twice", lambda text: text.replace(": 8", ": 7"), ":keys[1].token: must be the token before it, and 1"),
    ("time", lambda text: text.replace("2027-01-15T08:00:00Z", LONG), ":keys[0].created: must be a time like 2026-"),
    ("time is a number", lambda text: text.replace('"2027-01-15T08:00:00Z"', "1"), ":keys[0].created: must be a time"),
    ("time without zone", lambda text: text.replace("00:00Z", "00:00"), ":keys[0].created: must be a time like"),
    ("order", lambda text: text.replace("T10", "T03"), ":keys[1].active_from: is before that of the key before it"),
    ("no digits", lambda text: text.replace("5e5e", "5ex5", 1), ":keys[0].key: must be hexadecimal digits"),
    ("half a byte", lambda text: text.replace("5e5e", "5e5", 1), ":keys[0].key: must be hexadecimal digits"),
    ("key is a number", lambda text: text.replace(f'"{LONG}"', "1"), ":keys[0].key: must be hexadecimal digits"),
    ("short", lambda text: text.replace("5e5e", "5e", 1), ":keys[0].key: has 67 bytes, and PubSub-Aes256-CTR needs 68"),
    ("other policy's", lambda text: text.replace("256", "128"), ":keys[0].key: has 68 bytes, and PubSub-Aes128-CTR"),
]


@pytest.mark.parametrize(("change", "said"), [row[1:] for row in BROKEN], ids=[row[0] for row in BROKEN])
def test_a_broken_file_is_refused_with_its_place_and_without_its_keys(
    folder: KeyFolder, change: Callable[[str], str | bytes], said: str
) -> None:
    put(folder, change(GOOD))
    with pytest.raises(ConfigError) as caught:
        folder.read("t-2")
    text = str(caught.value)
    assert text.startswith(f"{folder.path_of('t-2')}{said}")
    assert "\n" not in text
    error: BaseException | None = caught.value
    while error is not None:
        assert "5e5e" not in str(error)
        error = error.__cause__


def test_no_representation_shows_a_key(folder: KeyFolder) -> None:
    key_file = made(folder)
    shown = f"{key_file!r} {key_file} {key_file.keys[0]!r}"
    assert key_file.keys[0].key_data.hex()[:8] not in shown
    assert repr(key_file.keys[0].key_data)[2:10] not in shown


def test_a_new_key_becomes_current_after_the_delay() -> None:
    first = KeyFile.new("t-2", AES256, 3600.0, NOW)
    second = first.rotated(NOW + 100, 10.0, 1)
    assert [key.token_id for key in second.keys] == [1, 2]
    assert [second.current_index(NOW + at) for at in (-5, 0, 109.9, 110, 1e6)] == [0, 0, 0, 1, 1]
    third = second.rotated(NOW + 101, 10.0, 1)
    assert [(key.token_id, key.active_from - NOW) for key in third.keys] == [(1, 0), (2, 110), (3, 120)]


@pytest.mark.parametrize(
    ("past_keys", "kept"), [(0, [4, 5]), (1, [3, 4, 5]), (3, [1, 2, 3, 4, 5]), (9, [1, 2, 3, 4, 5])]
)
def test_replaced_keys_that_stay(past_keys: int, kept: list[int]) -> None:
    key_file = KeyFile.new("t-2", AES256, 3600.0, NOW)
    for number in range(4):
        key_file = key_file.rotated(NOW + 100 * number, 10.0, past_keys)
    assert [key.token_id for key in key_file.keys] == kept


def test_a_leaked_key_is_replaced_at_once() -> None:
    key_file = KeyFile.new("t-2", AES256, 3600.0, NOW).rotated(NOW, 10.0, 1).replaced(NOW + 1)
    assert [(key.token_id, key.active_from) for key in key_file.keys] == [(3, NOW + 1)]


def test_token_ids_go_on_at_1_after_the_last(folder: KeyFolder) -> None:
    last = FileKey(MAX_TOKEN_ID, NOW, NOW, bytes(68))
    key_file = KeyFile("t-2", AES256, 60.0, (last,)).rotated(NOW, 0.0, 1)
    folder.write(key_file)
    assert [key.token_id for key in folder.read("t-2").keys] == [MAX_TOKEN_ID, 1]


def test_a_failed_write_leaves_the_old_file(folder: KeyFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    key_file = made(folder)

    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ConfigError, match=r"t-2\.json: cannot be written: no space left on device"):
        folder.write(key_file.rotated(NOW, 1.0, 1))
    assert folder.read("t-2") == key_file
    assert [path.name for path in folder.path.iterdir()] == ["t-2.json"]


def test_every_change_has_another_stamp(folder: KeyFolder) -> None:
    key_file = made(folder)
    first = folder.stamp("t-2")
    assert folder.stamp("t-2") == first
    folder.write(key_file)  # the same content, in the same millisecond perhaps
    second = folder.stamp("t-2")
    assert second != first
    folder.path_of("t-2").chmod(0o400)
    assert folder.stamp("t-2") not in (first, second)


def test_a_reader_always_sees_a_whole_file(folder: KeyFolder) -> None:
    key_file = made(folder)
    done = threading.Event()
    failures: list[Exception] = []

    def read() -> None:
        while not done.is_set():
            try:
                folder.read("t-2")
            except ConfigError as error:
                failures.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    for number in range(50):
        key_file = key_file.rotated(NOW + number, 0.0, 3)
        folder.write(key_file)
    done.set()
    reader.join()
    assert failures == []
