"""Reading a backup: whether it is whole, and putting it in the place of what is there.

What a process did after the backup is not in it. So what must never be used or done twice is made safe:

    nonces.json            all nonces of its keys count as used: nothing is sent under them any more
    security-groups.json   keys that nobody has, with tokens beyond all that were given
    lease_numbers.json     numbers beyond all that were given
    server.db, carried.db  a request without an end is asked after and never sent as a request to begin
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import shutil
import sqlite3
import tarfile
import tempfile
from collections.abc import Callable, Generator, Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

from ua_fleet.errors import StorageUnavailable
from ua_fleet.pubsub.security.nonces import LAST_NUMBER
from ua_fleet.storage.carried_records import CARRIED_FILE, OPEN_CARRIED
from ua_fleet.storage.database import version_of, what_is_broken
from ua_fleet.storage.files import UNFINISHED, make_private_folder, sync_folder, write_whole
from ua_fleet.storage.state_files import (
    BEFORE,
    MANIFEST,
    BackupDamaged,
    Manifest,
    is_database,
)

__all__ = ["OpenWork", "Restored", "open_work", "put_in_place", "unpacked"]

_TOKENS_BEYOND: Final = 100_000
_MAX_TOKEN_ID: Final = 0xFFFF_FFFF
_LEASES_BEYOND: Final = 1_000_000
_OPEN_RUNS: Final = {
    "server.db": "SELECT run_id FROM runs WHERE ended = 0",
    CARRIED_FILE: OPEN_CARRIED,
}
"""The files that have runs and requests to robots, with what finds the runs without an end."""
_NO_SUCH_FILE: Final = (ValueError, KeyError, TypeError, AttributeError, RecursionError)
"""What is raised for JSON that is not of the form that a file has."""
_PIECE_BYTES: Final = 1024 * 1024
_MOST_MANIFEST_BYTES: Final = 64 * 1024 * 1024


class OpenWork(NamedTuple):
    """What had no end when the backup was made."""

    runs: int
    requests: int


class Restored(NamedTuple):
    """What a restore has left."""

    aside: list[Path]
    """Where that is now what was there before."""
    broken: list[Path]
    """Files that could not be made safe, since they were broken in the fleet: they are as they were there."""


@contextlib.contextmanager
def unpacked(backup: Path, program: str, within: Path) -> Generator[tuple[Manifest, Path]]:
    """The files of a backup in a folder that goes when the context ends, once each is found to be as it was.

    Args:
        backup: the file.
        program: the version of this ua-fleet.
        within: where the folder is made; it needs the room of the backup.

    Raises:
        BackupDamaged: it is not whole.
        StorageUnavailable: it is of a newer ua-fleet, or cannot be read.
    """
    try:
        with tempfile.TemporaryDirectory(prefix=".ua-fleet-state-", dir=within) as folder:
            yield _unpack(backup, program, Path(folder)), Path(folder)
    except OSError as error:
        place = error.filename or backup
        raise StorageUnavailable(f"{place}: {error.strerror or error}") from error


def _unpack(backup: Path, program: str, folder: Path) -> Manifest:
    found: dict[str, str] = {}
    manifest: Manifest | None = None
    try:
        with tarfile.open(backup, "r:") as archive:
            for entry in archive:
                if manifest is not None:
                    raise BackupDamaged(f"{backup}: it has data after its {MANIFEST}, which must be the last entry")
                if entry.name == MANIFEST:
                    manifest = _manifest(archive, entry, program)
                else:
                    found[entry.name] = _extract(archive, entry, folder)
    except (tarfile.TarError, EOFError) as error:
        raise BackupDamaged(f"{backup}: is no whole backup ({error}); take another one") from error
    except BackupDamaged as error:
        raise BackupDamaged(f"{backup}: {error}; take another one") from None
    if manifest is None:
        raise BackupDamaged(f"{backup}: its end is missing; take another one")
    for name in sorted(found.keys() | manifest.files.keys()):
        if found.get(name) != manifest.files.get(name):
            what = "is missing" if name not in found else "was changed"
            raise BackupDamaged(f"{backup}: {name} {what}; take another one")
    for name in sorted(found):
        path = folder / name
        if is_database(path) and (reason := what_is_broken(path)):
            raise BackupDamaged(f"{backup}: {name} is broken ({reason}); it was so when the backup was made")
    return manifest


def _manifest(archive: tarfile.TarFile, entry: tarfile.TarInfo, program: str) -> Manifest:
    file = archive.extractfile(entry)
    if file is None or entry.size > _MOST_MANIFEST_BYTES:
        raise BackupDamaged(f"{MANIFEST} is no file")
    return Manifest.decode(file.read(), program)


def _extract(archive: tarfile.TarFile, entry: tarfile.TarInfo, folder: Path) -> str:
    """Write one file; its hash. A name that leads elsewhere, and whatever is no file, is refused."""
    parts = PurePosixPath(entry.name).parts
    file = archive.extractfile(entry) if entry.isreg() else None
    if file is None or len(parts) < 2 or "/" in parts or ".." in parts:
        raise BackupDamaged(f"{entry.name!r} is no file of a state")
    path = folder.joinpath(*parts)
    make_private_folder(path.parent)
    digest = hashlib.sha256()
    with open(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o600), "wb") as target:
        while piece := file.read(_PIECE_BYTES):
            digest.update(piece)
            target.write(piece)
        if target.tell() != entry.size:
            raise BackupDamaged(f"{entry.name} is cut short")
        if os.geteuid() == 0:
            os.fchown(target.fileno(), entry.uid, entry.gid)
        os.fchmod(target.fileno(), entry.mode & 0o777)
    return digest.hexdigest()


def open_work(folder: Path) -> OpenWork:
    """What had no end in the records of the server and of bridges that carry runs, as they are unpacked in a folder.

    A run that several of them know counts once.
    """
    runs, requests = set[str](), 0
    for path in sorted(folder.glob("*/*.db")):
        if not _has_requests(path):
            continue
        with contextlib.closing(sqlite3.connect(path)) as database:
            runs.update(run_id for (run_id,) in database.execute(_OPEN_RUNS[path.name]))
            [count] = database.execute("SELECT count(*) FROM requests WHERE outcome IS NULL").fetchone()
            requests += count
    return OpenWork(len(runs), requests)


def _has_requests(path: Path) -> bool:
    """Whether it is such a file; one without tables is what a process leaves that was killed as it began it."""
    return path.name in _OPEN_RUNS and version_of(path) > 0


def put_in_place(folder: Path, folders: Mapping[str, Path], manifest: Manifest, now: datetime) -> Restored:
    """Put what is unpacked into the folders of a fleet whose processes do not run.

    A restore that is killed is to be done again: until then no process starts in a folder that is not whole.

    Args:
        folder: with what is unpacked, by the names of the backup.
        folders: of the fleet, by these names.
        manifest: of the backup.
        now: the time, in UTC.

    Raises:
        StorageUnavailable: a folder is not the fleet's, or a file cannot be written.
    """
    names = sorted(entry.name for entry in folder.iterdir())
    if unknown := [name for name in names if name not in folders]:
        raise StorageUnavailable(f"fleet.yaml has no {unknown[0]!r}; add what was removed since the backup")
    elapsed_s = max(0, int((now - datetime.fromisoformat(manifest.made)).total_seconds()))
    try:
        broken: list[Path] = []
        for name in names:
            files = [path for path in sorted((folder / name).rglob("*")) if path.is_file()]
            unsafe = [path for path in files if not _make_safe(path, elapsed_s)]
            broken += [folders[name] / path.relative_to(folder / name) for path in unsafe]
        for name in names:
            target = folders[name]
            make_private_folder(target)
            shutil.rmtree(target / UNFINISHED, ignore_errors=True)
            (target / UNFINISHED).mkdir(mode=0o700)
            sync_folder(target)
        others = set(folders.values())
        stamp = f"{BEFORE}{now:%Y%m%dT%H%M%SZ}"
        moved = [_replace(folder / name, folders[name], stamp, others) for name in names]
        for name in names:
            (folders[name] / UNFINISHED).rmdir()
            sync_folder(folders[name])
    except OSError as error:
        place = error.filename or folder
        raise StorageUnavailable(
            f"{place}: {error.strerror or error}; the state is not whole until this restore is done again"
        ) from error
    return Restored([path for path in moved if path is not None], broken)


def _replace(source: Path, target: Path, stamp: str, others: set[Path]) -> Path | None:
    """Move what is in a folder aside, and what was restored there in its place; where that is that was moved."""
    prepared = target / UNFINISHED
    for entry in sorted(source.iterdir()):
        shutil.move(entry, prepared / entry.name)  # copies where that is another disk
    _give_to_owner(prepared, target)
    for path in (prepared, *[path for path in prepared.rglob("*") if path.is_dir()]):
        sync_folder(path)
    aside = target / stamp
    for entry in sorted(target.iterdir()):
        is_others = any(other == entry or entry in other.parents for other in others - {target})
        if entry == prepared or entry.name.startswith(BEFORE) or is_others or entry.suffix == ".lock":
            continue
        aside.mkdir(mode=0o700, exist_ok=True)
        entry.rename(aside / entry.name)
    for entry in sorted(prepared.iterdir()):
        _merge(entry, target / entry.name)
    return aside if aside.exists() else None


def _merge(entry: Path, target: Path) -> None:
    """Move a file, or the files of a folder in which there are folders of others."""
    if target.is_dir() and entry.is_dir():
        for inner in sorted(entry.iterdir()):
            _merge(inner, target / inner.name)
        entry.rmdir()
    else:
        entry.rename(target)


def _give_to_owner(prepared: Path, target: Path) -> None:
    """Where root restores, folders belong to the owner of the state, as its files do."""
    if os.geteuid() == 0:
        status = target.stat()
        for path in [path for path in prepared.rglob("*") if path.is_dir()]:
            os.chown(path, status.st_uid, status.st_gid)


def _make_safe(path: Path, elapsed_s: int) -> bool:
    """See the table above. False: it is no such file, is left as it is, and is refused by its process."""
    is_safe = True
    if _has_requests(path):
        with contextlib.closing(sqlite3.connect(path)) as database, database:
            database.execute("UPDATE requests SET timeout_ms = 0 WHERE outcome IS NULL")
    changes: dict[str, Callable[[dict[str, Any]], None]] = {
        "nonces.json": _used_up,
        "security-groups.json": _new_keys,
        "lease_numbers.json": lambda document: _later_leases(document, elapsed_s),
    }
    if (change := changes.get(path.name)) is not None:
        try:
            document: dict[str, Any] = json.loads(path.read_bytes())
            change(document)
        except _NO_SUCH_FILE:
            is_safe = False
        else:
            write_whole(path, json.dumps(document).encode(), like=path.stat())
    for beside in (path.with_name(f"{path.name}-wal"), path.with_name(f"{path.name}-shm")):
        beside.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    return is_safe


def _used_up(document: dict[str, Any]) -> None:
    for group in document["groups"].values():
        group["reserved"] = dict.fromkeys(group["reserved"], LAST_NUMBER)
        group["pruned_number"] = LAST_NUMBER


def _new_keys(document: dict[str, Any]) -> None:
    for group in document["groups"].values():
        keys = [bytes.fromhex(key) for key in group["keys"]]
        group["first_token"] = (int(group["first_token"]) - 1 + len(keys) + _TOKENS_BEYOND) % _MAX_TOKEN_ID + 1
        group["keys"] = [secrets.token_hex(len(key)) for key in keys]
        group["current"], group["since"] = 0, datetime.now(UTC).timestamp()


def _later_leases(document: dict[str, Any], elapsed_s: int) -> None:
    document["reserved"] = min(document["reserved"] + _LEASES_BEYOND + elapsed_s, 0xFFFF_FFFF)
