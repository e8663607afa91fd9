"""Which files of a `state_dir` are state, and how a backup holds them.

A backup is a tar file: the files as `<folder>/<path>`, then `manifest.json` as the last one, with the SHA-256 of each
and of itself. So a file that was cut short has no manifest, and one that was changed does not fit it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

from ua_fleet.errors import UPGRADE, StorageUnavailable, UaFleetError, newer_version
from ua_fleet.storage.files import UNFINISHED

__all__ = [
    "BEFORE",
    "MANIFEST",
    "VERSION",
    "BackupDamaged",
    "Manifest",
    "StateFile",
    "is_database",
    "state_files",
]

VERSION: Final = 1
MANIFEST: Final = "manifest.json"
BEFORE: Final = "before-restore-"
"""What was there before a restore is moved into a folder whose name begins so."""
_FIRST: Final = "audit.head"
"""Says which lines of the audit log there are at least, so it is read before them."""
_NO_STATE: Final = re.compile(
    r"monitoring\.json|monitoring\.new|.*\.(lock|control)|.*\.db-(wal|shm|journal)|\..*\.[0-9a-f]{8}"
    rf"|{re.escape(BEFORE)}.*|{re.escape(UNFINISHED)}"
)
"""What a process makes anew: locks, logs of databases (their content is in the copy), files that are being written."""


class BackupDamaged(UaFleetError):
    """A backup is not as it was made."""

    remedy = "Take another backup; `ua-fleet state check FILE` tells whether it is whole."


class StateFile(NamedTuple):
    """One file of the state."""

    name: str
    """In a backup: the folder's name, then the path in it."""
    path: Path


class Manifest(NamedTuple):
    """What a backup says of itself."""

    fleet: str
    made: str
    """When, as ISO 8601 in UTC."""
    program: str
    """The version of ua-fleet."""
    postgres: str
    """The database that has the history; empty where none does. It is not in the backup."""
    files: Mapping[str, str]
    """The SHA-256 of each."""

    def encode(self) -> bytes:
        """As it stands in the backup."""
        document = {"version": VERSION, **self._asdict(), "files": dict(self.files)}
        return json.dumps({**document, "sha256": _digest(document)}, indent=1).encode()

    @classmethod
    def decode(cls, data: bytes, program: str) -> Manifest:
        """Read one.

        Args:
            data: as it stands in the backup.
            program: the version of this ua-fleet.

        Raises:
            BackupDamaged: it is not as it was written.
            StorageUnavailable: a newer ua-fleet made the backup.
        """
        try:
            document: dict[str, Any] = json.loads(data)
            newer = newer_version(document["version"], VERSION)
            said, digest = str(document["program"]), document.pop("sha256")
            if not newer and _numbers(said) > _numbers(program):
                newer = f"was made by ua-fleet {said}, and this is ua-fleet {program}"
            if not newer:
                if digest != _digest(document):
                    raise ValueError
                return cls(*[document[field] for field in cls._fields])
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise BackupDamaged(f"{MANIFEST} was changed") from None
        raise StorageUnavailable(f"the backup {newer}; {UPGRADE}")


def _digest(document: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)[:3]]


def state_files(folders: Mapping[str, Path]) -> Iterator[StateFile]:
    """The files of these folders in the order in which they are read. One in another is its own, and not the other's.

    Links are not followed, since what they lead to is not the fleet's alone.

    Raises:
        OSError: a folder cannot be read.
    """
    others = set(folders.values())
    for name, folder in folders.items():
        if folder.is_dir():
            for path in _files(folder, others - {folder}):
                yield StateFile(str(PurePosixPath(name, path.relative_to(folder).as_posix())), path)


def _files(folder: Path, others: set[Path]) -> Iterator[Path]:
    entries = sorted(os.scandir(folder), key=lambda entry: (entry.name != _FIRST, entry.name))
    for entry in entries:
        path = folder / entry.name
        if _NO_STATE.fullmatch(entry.name) or entry.is_symlink() or path in others:
            continue
        if entry.is_dir():
            yield from _files(path, others)
        elif stat.S_ISREG(entry.stat().st_mode):
            yield path


def is_database(path: Path) -> bool:
    """Whether a file is one of SQLite, by its name."""
    return path.suffix == ".db"
