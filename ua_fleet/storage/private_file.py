"""Files with secrets, which several processes of one user of the machine read and change."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections.abc import Generator
from pathlib import Path
from typing import Final

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.files import make_private_folder

__all__ = ["exclusive", "not_private", "read_password", "signature_of"]

_MOST_PASSWORD_BYTES: Final = 4_096


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


def read_password(path: Path, key: str) -> str:
    """The first line of a file that only its owner may read.

    Args:
        path: of the file.
        key: of `fleet.yaml` that names it, for errors.

    Raises:
        StorageUnavailable: it is not there, others may read it, or it has no such line.
    """
    try:
        with path.open("rb") as file:
            complaint = not_private(path, os.fstat(file.fileno()))
            line = file.read(_MOST_PASSWORD_BYTES).split(b"\n", 1)[0].removesuffix(b"\r")
        text = line.decode()
    except OSError as error:
        raise StorageUnavailable(f"{key}: {path}: {error.strerror}; write the password into its first line") from None
    except UnicodeDecodeError:
        raise StorageUnavailable(f"{key}: {path} is no UTF-8 text; write the password into its first line") from None
    if complaint:
        raise StorageUnavailable(f"{key}: {complaint}")
    if not text:
        raise StorageUnavailable(f"{key}: the first line of {path} is empty; write the password there")
    return text
