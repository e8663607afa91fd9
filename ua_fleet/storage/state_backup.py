"""A backup of the state of all processes of a machine, while they run.

    process   hold ------------------------------------ still held? release
    backup         copy its databases, then the rest                        manifest, sync, rename

The databases of a process are as of one moment: their files stand still while they are read here, and what is
committed meanwhile is in their logs. All other files are replaced as a whole when they change, so that a copy of one
is whole too; of the audit log, the lines that are there are taken.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tarfile
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Final, cast

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.control import SUFFIX, Held, held_by
from ua_fleet.storage.database import copy_unused
from ua_fleet.storage.files import sync_folder
from ua_fleet.storage.state_files import MANIFEST, Manifest, StateFile, is_database, state_files

__all__ = ["write_backup"]

_LOG: Final = "audit.log"
_TAIL_BYTES: Final = 1024 * 1024
"""The end of a log in which its last whole line is looked for."""


class _Hashed(io.RawIOBase):
    """Reads a file, and hashes what it reads."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.digest = hashlib.sha256()

    def read(self, size: int = -1) -> bytes:
        data = self._file.read(size)
        self.digest.update(data)
        return data


def write_backup(target: Path, folders: Mapping[str, Path], about: Manifest) -> Manifest:
    """Write a backup, whole or not at all.

    Args:
        target: the file, which is not there yet. Only its owner may read it, since keys and passwords are in it.
        folders: with the state, by their names in the backup.
        about: what it says of itself, without files.

    Returns:
        The same with the files.

    Raises:
        StorageUnavailable: a file cannot be read or written, or a process does not hold its databases.
    """
    if target.exists():
        raise StorageUnavailable(f"{target} is there already; name another file")
    if inside := [folder for folder in folders.values() if folder in target.resolve().parents]:
        raise StorageUnavailable(f"{target} would be in the state, {inside[0]}; name a file elsewhere")
    try:
        with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as folder:
            part = Path(folder, "part")
            with open(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o600), "wb") as file:
                with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as archive:
                    manifest = about._replace(files=_copy_all(archive, folders, Path(folder)))
                    _add(archive, MANIFEST, io.BytesIO(manifest.encode()), len(manifest.encode()), None)
                file.flush()
                os.fsync(file.fileno())
            os.link(part, target)  # unlike a rename, never in the place of another one
            sync_folder(target.parent)
    except FileExistsError:
        raise StorageUnavailable(f"{target} is there already; name another file") from None
    except OSError as error:
        place = error.filename or target
        raise StorageUnavailable(f"{place}: {error.strerror or error}; no backup was made") from error
    return manifest


def _copy_all(archive: tarfile.TarFile, folders: Mapping[str, Path], working: Path) -> dict[str, str]:
    """Add all files; the hash of each."""
    with contextlib.ExitStack() as cleanup:
        held: dict[Path, Held] = {}
        for place in _controls(folders):
            if (process := cleanup.enter_context(held_by(place))) is not None:
                held |= dict.fromkeys((path.resolve() for path in process.files), process)
        files = list(state_files(folders))
        found: dict[str, str] = {}
        for file in [one for one in files if is_database(one.path)]:
            found[file.name] = _database(archive, file, working, is_held=file.path in held)
        for process in dict.fromkeys(held.values()):
            process.still()
        for file in [one for one in files if not is_database(one.path)]:
            with contextlib.suppress(FileNotFoundError):  # removed since, such as a rejected certificate
                found[file.name] = _file(archive, file.name, file.path, file.path.name == _LOG)
        return found


def _controls(folders: Mapping[str, Path]) -> list[Path]:
    """The sockets of processes."""
    return [path for folder in folders.values() if folder.is_dir() for path in sorted(folder.glob(f"*{SUFFIX}"))]


def _database(archive: tarfile.TarFile, file: StateFile, working: Path, *, is_held: bool) -> str:
    if is_held:
        return _file(archive, file.name, file.path, False)
    copy = working / "database"
    copy_unused(file.path, copy)
    os.chmod(copy, file.path.stat().st_mode & 0o777)
    try:
        return _file(archive, file.name, copy, False)
    finally:
        copy.unlink()


def _file(archive: tarfile.TarFile, name: str, path: Path, is_log: bool) -> str:
    with path.open("rb") as opened:
        status = os.fstat(opened.fileno())
        size = _whole_lines(opened, status.st_size) if is_log else status.st_size
        return _add(archive, name, opened, size, status)


def _whole_lines(file: IO[bytes], size: int) -> int:
    """The size without a line that is being written."""
    begin = max(0, size - _TAIL_BYTES)
    file.seek(begin)
    end = file.read(size - begin).rfind(b"\n")
    file.seek(0)
    return begin + end + 1


def _add(archive: tarfile.TarFile, name: str, file: IO[bytes], size: int, status: os.stat_result | None) -> str:
    entry = tarfile.TarInfo(name)
    entry.size, entry.mode = size, 0o600
    if status is not None:
        entry.mode, entry.mtime = status.st_mode & 0o777, int(status.st_mtime)
        entry.uid, entry.gid = status.st_uid, status.st_gid
    hashed = _Hashed(file)
    archive.addfile(entry, cast("IO[bytes]", hashed))
    return hashed.digest.hexdigest()
