"""One process for each purpose: a file that is locked while it runs."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import structlog

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.files import make_private_folder, unfinished_restore

__all__ = ["process_lock"]

_log = structlog.get_logger("ua_fleet.storage")


@contextmanager
def process_lock(path: Path, what: str, *, restores: bool = False) -> Generator[None]:
    """Keep other processes out while the context lasts. The kernel lifts the lock of a process that was killed.

    Where no file can be made, such as on a disk that is read only, nobody is kept out, and the log says so.

    Args:
        path: of the file, which stays.
        what: runs, e.g. `bridge cell`, for the message.
        restores: whether the caller makes a state whole which a restore that was killed has left.

    Raises:
        StorageUnavailable: another process has it, or the folder's state is not whole.
    """
    if not restores and (problem := unfinished_restore(path.parent)):
        raise StorageUnavailable(problem)
    try:
        make_private_folder(path.parent)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        _log.warning("a second process of this kind would not be noticed", path=str(path), reason=error.strerror)
        yield
        return
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StorageUnavailable(
                f"{path}: {what} runs already; stop that process, or give this one a state_dir of its own"
            ) from error
        yield
    finally:
        os.close(descriptor)
