"""Files are there whole or not at all, and what must outlive a power cut does."""

from __future__ import annotations

import asyncio
import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from ua_fleet.client import ClientIdentity
from ua_fleet.config.assign_ids import assign_ids
from ua_fleet.endpoint.users import Role, ScryptCost, UserStore
from ua_fleet.storage.files import write_whole
from ua_fleet.storage.key_files import KeyFile, KeyFolder
from ua_fleet.storage.nonces import FileNonces
from ua_fleet.storage.private_file import exclusive
from ua_fleet.wire.security import SecurityPolicy


def _add_user(folder: Path) -> None:
    UserStore(folder / "users.yaml", ScryptCost(2**4, 8, 1)).add("anna", "a-long-word", Role.OPERATOR)


def _make_identity(folder: Path) -> None:
    asyncio.run(ClientIdentity(folder).ensure())


def _meet_server(folder: Path) -> None:
    ClientIdentity(folder).check_server("opc.tcp://127.0.0.1:4840", b"no certificate")


def _assign_ids(folder: Path) -> None:
    file = folder / "fleet.yaml"
    file.write_text("""\
version: 1
fleet: {name: hall}
pubsub: {security: none}
bridges: {hall: {kind: ros1, status_id: 1}}
robots: {rover: {bridge: hall, data: {speed: {type: Double}}}}
""")
    assert assign_ids(file, {}) == {"robots.rover.data.speed.id": 1001}


WRITERS: dict[str, Callable[[Path], object]] = {
    "any": lambda folder: write_whole(folder / "any", b"new"),
    "users": _add_user,
    "identity": _make_identity,
    "met servers": _meet_server,
    "ids": _assign_ids,
    "keys": lambda folder: KeyFolder(folder).write(KeyFile.new("t-2", SecurityPolicy.AES256_CTR, 60.0, 0.0)),
    "nonces": lambda folder: FileNonces(folder).reserve("t-2", 7, 100),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_it_is_durable_once_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: str) -> None:
    tmp_path.chmod(0o700)
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def noted_fsync(file: int) -> None:
        steps.append("folder" if Path(f"/proc/self/fd/{file}").readlink() == tmp_path else "file")
        fsync(file)

    def noted_replace(path: Path, target: Path) -> Path:
        steps.append("replace")
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(Path, "replace", noted_replace)
    WRITERS[writer](tmp_path)
    files = 2 if writer == "identity" else 1
    assert steps == ["file", "replace", "folder"] * files


@pytest.mark.parametrize("step", ["file", "replace"])
def test_what_cannot_be_written_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    path = tmp_path / "file"
    write_whole(path, b"old")

    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if step == "replace":
        monkeypatch.setattr(Path, "replace", fail)
    else:
        monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new")
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("file", b"old")]


@pytest.mark.parametrize(("number", "is_told"), [(errno.EIO, True), (errno.EINVAL, False)])
def test_a_folder_that_cannot_be_synced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, is_told: bool
) -> None:
    fsync = os.fsync

    def broken(file: int) -> None:
        if Path(f"/proc/self/fd/{file}").readlink() == tmp_path:
            raise OSError(number, os.strerror(number))
        fsync(file)

    monkeypatch.setattr(os, "fsync", broken)
    told: OSError | None = None
    try:
        write_whole(tmp_path / "file", b"new")
    except OSError as error:
        told = error
    assert (told is not None) is is_told, "a file system that has no such thing is no failure"
    assert [(one.name, one.read_bytes()) for one in tmp_path.iterdir()] == [("file", b"new")]


@pytest.mark.parametrize(("mode", "umask", "seen"), [(0o600, 0, 0o600), (0o644, 0o022, 0o644), (0o644, 0o077, 0o600)])
def test_modes(tmp_path: Path, mode: int, umask: int, seen: int) -> None:
    before = os.umask(umask)
    try:
        write_whole(tmp_path / "new" / "file", b"", mode)
    finally:
        os.umask(before)
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "new" / "file").stat().st_mode & 0o777 == seen


def test_one_like_another(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.touch()
    path.chmod(0o664)
    if os.geteuid() == 0:
        os.chown(path, 12, 34)
    before = path.stat()
    write_whole(path, b"new", like=before)
    after = path.stat()
    assert (after.st_mode, after.st_uid, after.st_gid) == (before.st_mode, before.st_uid, before.st_gid)
    assert after.st_ino != before.st_ino


def test_all_folders_that_are_made_are_their_owners_alone(tmp_path: Path) -> None:
    before = os.umask(0o002)
    try:
        write_whole(tmp_path / "a" / "b" / "c" / "file", b"x")
        with exclusive(tmp_path / "d" / "e" / "file.json"):
            pass
    finally:
        os.umask(before)
    for folder in ("a", "a/b", "a/b/c", "d", "d/e"):
        assert (tmp_path / folder).stat().st_mode & 0o777 == 0o700, folder
