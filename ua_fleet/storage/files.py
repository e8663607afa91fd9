"""Files that are there whole or not at all, also after a power cut."""

from __future__ import annotations

import errno
import os
import secrets
from pathlib import Path
from typing import Final

from ua_fleet.printing import config_option

__all__ = ["UNFINISHED", "make_private_folder", "open_to_others", "sync_folder", "unfinished_restore", "write_whole"]

UNFINISHED: Final = ".restoring"
"""The folder in which a restore prepares; while it is there, the state is not whole."""


def make_private_folder(path: Path) -> None:
    """Make a folder and those around it that are missing, each for its owner alone whatever the umask.

    `mkdir` gives its mode to the last one only: with a umask of 002 the others could be written to by the group.

    Raises:
        OSError: it cannot be made.
    """
    if not path.parent.exists():
        make_private_folder(path.parent)
    path.mkdir(exist_ok=True, mode=0o700)


def write_whole(path: Path, data: bytes, mode: int = 0o600, *, like: os.stat_result | None = None) -> None:
    """Put a file in the place of the one that is there, if any, or leave that one as it is.

    Once this returns, the new file outlives a power cut. A folder that is missing is made, for its owner alone.

    Args:
        path: of the file; a link there is replaced.
        data: all of it.
        mode: less the umask, from the first byte on.
        like: a file whose mode and, where we may, owner the new one gets in the end.

    Raises:
        OSError: it cannot be written. Where only the folder could not be synced, the new file is in its place.
    """
    make_private_folder(path.parent)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    descriptor = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            if like is not None:
                if (like.st_uid, like.st_gid) != (os.geteuid(), os.getegid()) and os.geteuid() == 0:
                    os.fchown(descriptor, like.st_uid, like.st_gid)
                os.fchmod(descriptor, like.st_mode & 0o7777)
            os.fsync(descriptor)
        temporary.replace(path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno is not None and error.filename is None:
            error.filename = str(path)  # that of a write to a descriptor names no file
        raise
    sync_folder(path.parent)


def open_to_others(path: Path, status: os.stat_result | None = None) -> str:
    """Why somebody else could change what stands in a folder or file, with the remedy; empty when nobody can.

    Raises:
        OSError: it cannot be looked at.
    """
    status = status or path.stat()
    if status.st_mode & 0o022:
        return f"{path}: others may write there (mode {status.st_mode & 0o777:o}); run: chmod go-w {path}"
    if status.st_uid not in (os.geteuid(), 0):
        return f"{path}: belongs to another user; run: chown $USER {path}"
    return ""


def sync_folder(path: Path) -> None:
    """Have the names of its files outlive a power cut.

    Raises:
        OSError: it cannot be synced.
    """
    folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(folder)
    except OSError as error:
        # Some network file systems have no such thing: there the server has renamed the file before it answers.
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(folder)


def unfinished_restore(folder: Path) -> str:
    """Why no process may use a folder with state in which a restore was killed; empty where none was."""
    if not (folder / UNFINISHED).exists():
        return ""
    return f"{folder}: a restore did not end; do it again: ua-fleet state restore FILE{config_option()}"
