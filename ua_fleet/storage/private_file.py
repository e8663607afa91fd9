"""Files with secrets, which several processes of one user of the machine read and change."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Generator
from pathlib import Path

from ua_fleet.storage.files import make_private_folder

__all__ = ["exclusive", "not_private", "signature_of"]


def signature_of(status: os.stat_result) -> tuple[int, ...]:
    """What differs when a file has been changed."""
    return status.st_mtime_ns, status.st_ino, status.st_size, status.st_mode, status.st_uid


def not_private(path: Path, status: os.stat_result) -> str:
    """Why the secrets of a file may be known to others, with the remedy; empty when nobody else can read it."""
    if status.st_mode & 0o077:
        return f"{path}: others may read or write it (mode {status.st_mode & 0o777:o}); run: chmod 600 {path}"
    if status.st_uid not in (os.geteuid(), 0):
        return f"{path}: belongs to another user; run: chown $USER {path}"
    return ""


@contextlib.contextmanager
def exclusive(path: Path) -> Generator[None]:
    """Keep other processes from changing a file at the same time."""
    make_private_folder(path.parent)
    lock = os.open(path.with_suffix(".lock"), os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)
