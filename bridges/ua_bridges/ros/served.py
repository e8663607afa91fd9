"""Which subscribers a bridge has served, kept for the bridge that is started after it.

A value that the bridge before this one had published is owed to a subscriber that is new, and not to one that has it.
Their names do not tell: a robot that is restarted has its old name. So each is known by what is unique to its process.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
from pathlib import Path
from typing import Final

__all__ = ["Served"]

_KEY_BYTES: Final = 16
_MOST_KEPT: Final = 4096
"""Subscribers of the bridge before this one that are still known; the oldest go."""


class Served:
    """The subscribers of a bridge. Without a folder, or while another bridge has the file, there was none before."""

    def __init__(self, folder: Path | None, *identity: object) -> None:
        """`identity` tells this bridge from all others of the machine."""
        name = hashlib.sha256("\0".join(str(part) for part in identity).encode()).hexdigest()[:20]
        self._before: frozenset[bytes] = frozenset()
        self._noted: set[bytes] = set()
        self._file = -1
        if folder is not None:
            with contextlib.suppress(OSError):
                self._open(folder / f"served-{name}")

    def _open(self, path: Path) -> None:
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            size = os.fstat(file).st_size // _KEY_BYTES * _KEY_BYTES
            start = max(0, size - _MOST_KEPT * _KEY_BYTES)
            content = os.pread(file, size - start, start)
            os.ftruncate(file, 0)
            os.write(file, content)
        except OSError:
            os.close(file)
            raise
        self._file = file
        keys = [content[at : at + _KEY_BYTES] for at in range(0, len(content), _KEY_BYTES)]
        self._before = frozenset(keys)
        self._noted.update(keys)

    @staticmethod
    def _key(subscriber: bytes) -> bytes:
        return hashlib.blake2b(subscriber, digest_size=_KEY_BYTES).digest()

    def before(self, subscriber: bytes) -> bool:
        """Whether the bridge before this one had served the subscriber."""
        return self._key(subscriber) in self._before

    def note(self, subscriber: bytes) -> None:
        """Remember that this bridge serves the subscriber."""
        key = self._key(subscriber)
        if key not in self._noted and len(self._noted) < 2 * _MOST_KEPT:
            self._noted.add(key)
            if self._file >= 0:
                os.write(self._file, key)

    def close(self) -> None:
        """Close the file; it stays for the next bridge."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1
