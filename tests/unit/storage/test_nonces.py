"""Reserved nonces survive a kill, and a file that cannot be understood is never taken for an empty one."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path
from typing import Any

import pytest

from ua_fleet.errors import ConfigError
from ua_fleet.pubsub.security.nonces import NoncesUnavailable
from ua_fleet.storage.nonces import MOST_TOKENS, FileNonces


def test_blocks_go_on_after_a_restart(tmp_path: Path) -> None:
    folder = tmp_path / "state" / "nonces"
    first = FileNonces(folder)
    assert [first.reserve("t-2", 7, 100), first.reserve("t-2", 7, 100), first.reserve("c-2", 7, 100)] == [1, 101, 1]
    again = FileNonces(folder)
    assert [again.reserve("t-2", 7, 5), again.reserve("t-2", 8, 5)] == [201, 1]
    assert first.reserve("t-2", 7, 100) == 206, "processes that share a folder share the numbers"


def test_only_the_owner_may_read(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    FileNonces(folder).reserve("t-2", 7, 100)
    assert oct(folder.stat().st_mode & 0o777) == "0o700"
    assert {path.name: oct(path.stat().st_mode & 0o777) for path in folder.iterdir()} == {
        "nonces.json": "0o600",
        "nonces.lock": "0o600",
    }


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_folder_that_others_may_write_is_refused(tmp_path: Path, mode: int) -> None:
    folder = tmp_path / "state"
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(ConfigError, match=f"chmod go-w {folder}"):
        FileNonces(folder)
    folder.chmod(0o755)
    assert FileNonces(folder).reserve("t-2", 1, 10) == 1


@pytest.mark.parametrize("step", ["file", "replace", "folder"])
def test_a_write_that_fails_gives_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    nonces = FileNonces(tmp_path)
    nonces.reserve("t-2", 7, 100)
    real_fsync = os.fsync

    def broken_fsync(file: int) -> None:
        name = Path(f"/proc/self/fd/{file}").readlink()
        if (name == tmp_path) is (step == "folder"):
            raise OSError(errno.ENOSPC, "No space left on device")
        real_fsync(file)

    def broken_replace(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as broken:
        if step == "replace":
            broken.setattr(Path, "replace", broken_replace)
        else:
            broken.setattr(os, "fsync", broken_fsync)
        with pytest.raises(
            NoncesUnavailable, match=r"nonces\.json: cannot be written \(No space left on device\); sending"
        ):
            nonces.reserve("t-2", 7, 100)
    assert nonces.reserve("t-2", 7, 100) in (101, 201)
    assert FileNonces(tmp_path).reserve("t-2", 7, 100) > 200


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        '{"version": 0, "groups": {}}',
        '{"version": 1}',
        '{"version": 1, "groups": {"t-2": {"reserved": {"7": -1}, "pruned": 0, "pruned_number": 0}}}',
        '{"version": 1, "groups": {"t-2": {"reserved": {"7": "100"}, "pruned": 0, "pruned_number": 0}}}',
        '{"version": 1, "groups": {"t-2": {"reserved": {"x": 100}, "pruned": 0, "pruned_number": 0}}}',
        '{"version": 1, "groups": {"t-2": []}}',
        "[" * 100_000,
    ],
)
def test_a_file_that_is_not_understood_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "nonces.json").write_text(text)
    with pytest.raises(ConfigError, match="is no file of reserved nonces; make new keys"):
        FileNonces(tmp_path)


def test_a_file_that_is_damaged_later_gives_nothing(tmp_path: Path) -> None:
    nonces = FileNonces(tmp_path)
    (tmp_path / "nonces.json").write_text("{")
    with pytest.raises(NoncesUnavailable, match="make new keys"):
        nonces.reserve("t-2", 7, 100)


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="give this user a folder that it can write"):
        FileNonces(tmp_path / "file" / "state")


def _document(folder: Path) -> Any:
    return json.loads((folder / "nonces.json").read_text())["groups"]["t-2"]


def test_old_tokens_are_pruned_and_their_numbers_never_come_again(tmp_path: Path) -> None:
    nonces = FileNonces(tmp_path)
    nonces.reserve("t-2", 1, 1000)
    for token_id in range(2, MOST_TOKENS + 11):
        assert nonces.reserve("t-2", token_id, 100) == 1
    document = _document(tmp_path)
    assert len(document["reserved"]) == MOST_TOKENS
    assert (document["pruned"], document["pruned_number"]) == (10, 1000)
    assert nonces.reserve("t-2", 3, 100) == 1001, "an old token that comes back goes on above all that was pruned"
    assert nonces.reserve("t-2", MOST_TOKENS + 11, 100) == 1


def test_tokens_that_begin_anew_are_later_ones(tmp_path: Path) -> None:
    nonces = FileNonces(tmp_path)
    top = 0xFFFF_FFFF
    for token_id in [*range(top - MOST_TOKENS, top + 1), 1, 2, 3]:
        assert nonces.reserve("t-2", token_id, 100) == 1
    assert nonces.reserve("t-2", top - MOST_TOKENS, 100) == 101
