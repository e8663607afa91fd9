"""The folders of a testbed's volumes: whether the job may work in them, and files that users may edit."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from ua_fleet.errors import ConfigError
from ua_fleet.storage.files import write_whole

__all__ = ["check_volume", "write_unless_edited"]

_WRITTEN = ".written"
"""Beside a file: the digest of what the job wrote into it last."""


def check_volume(folder: Path, user_id: int) -> None:
    """Raise ConfigError where a volume's folder cannot be used, or is open to others.

    Args:
        folder: of the volume; made where it is not there and that is possible.
        user_id: as whom all processes run.
    """
    name = folder.name
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except OSError as error:
        remedy = f"mount a volume there, or make the folder for user {user_id}"
        raise ConfigError(
            f"there is no volume {name}: {error.strerror}", file=str(folder), suggestion=remedy
        ) from error
    if status.st_uid != user_id:
        problem = f"the volume {name} belongs to user {status.st_uid}, and its processes run as {user_id}"
        remedy = f"remove it (docker volume rm), and it is made anew, or run there: chown -R {user_id} ."
        raise ConfigError(problem, file=str(folder), suggestion=remedy)
    mode = status.st_mode & 0o777
    if mode & 0o077 or mode & 0o700 != 0o700:
        problem = f"the volume {name} has the mode {mode:o}, and must be its owner's alone (700)"
        raise ConfigError(problem, file=str(folder), suggestion="run there: chmod 700 .")


def write_unless_edited(folder: Path, files: Mapping[str, str]) -> list[str]:
    """Write files whose text has changed; the paths of those that a user has edited, which are kept as they are.

    Args:
        folder: where they stand.
        files: text by path.
    """
    edited: list[str] = []
    for name, text in files.items():
        path = folder / name
        mark = path.with_name(f".{path.name}{_WRITTEN}")
        if path.exists():
            there = path.read_text(encoding="utf-8")
            if there == text:
                write_whole(mark, _digest(text).encode(), 0o644)
                continue
            if not mark.exists() or mark.read_text(encoding="utf-8") != _digest(there):
                edited.append(name)
                continue
        write_whole(path, text.encode(), 0o644)
        write_whole(mark, _digest(text).encode(), 0o644)
    return edited


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
