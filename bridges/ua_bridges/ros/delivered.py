"""What a bridge has published into its space, kept for the bridge that is started after it.

A bridge that comes up gets the last message of every source again, and cannot know from it whether the robots of its
space have it already: its predecessor may have published it, or may have died before. So each bridge notes the
Timestamp of the last message of each topic in a small file that is mapped into memory: one store of eight bytes for a
message, which survives `kill -9`. It does not survive the machine, and need not.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import mmap
import os
import stat
import struct
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ua_fleet.topics import Topic

__all__ = ["STATE_VARIABLE", "Delivered", "OnItsWay", "state_folder"]

STATE_VARIABLE: Final = "UA_FLEET_RUNTIME_DIR"
"""Names the folder of these files; else it is `ua_fleet` in XDG_RUNTIME_DIR, or a folder of the user's in /tmp."""

_ENTRY = struct.Struct("<HHHxxq")
_TIMESTAMP = struct.Struct("<q")
_TIMESTAMP_OFFSET: Final = 8
_GROWTH: Final = 1024
"""Entries by which the file grows."""
_MOST_ENTRIES: Final = 65_536


def state_folder() -> Path | None:
    """A folder that only this user can write to, made if need be; None when there is none."""
    named = os.environ.get(STATE_VARIABLE)
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(tempfile.gettempdir()) / f"ua_fleet-{os.getuid()}"
    if named:
        folder = Path(named)
    elif runtime and os.access(runtime, os.W_OK):
        folder = Path(runtime) / "ua_fleet"
    try:
        folder.mkdir(mode=0o700, parents=bool(named), exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022
    return folder if private else None


class OnItsWay:
    """A message that goes several ways, each now or later: when all are over, and it went at least one, it is noted."""

    def __init__(self, ways: int, note: Callable[[], None]) -> None:
        self._left, self._note = ways, note
        self._has_gone = False
        self._lock = threading.Lock()

    def gone(self) -> None:
        """It went one way. Callable from any thread."""
        self._over(has_gone=True)

    def failed(self) -> None:
        """It cannot go one way, ever."""
        self._over(has_gone=False)

    def _over(self, *, has_gone: bool) -> None:
        with self._lock:
            self._left -= 1
            self._has_gone = self._has_gone or has_gone
            is_over = not self._left and self._has_gone
        if is_over:
            self._note()


class Delivered:
    """The Timestamp of the last message of each topic that was published into a space.

    Without a folder, or while another bridge has the same file open, it remembers for this process alone.
    """

    def __init__(self, folder: Path | None, *identity: object) -> None:
        """`identity` tells this bridge from all others of the machine."""
        name = hashlib.sha256("\0".join(str(part) for part in identity).encode()).hexdigest()[:20]
        self._before: dict[Topic, int] = {}
        self._slots: dict[Topic, int] = {}
        self._lock = threading.Lock()
        self._file = -1
        self._map: mmap.mmap | None = None
        if folder is not None:
            with contextlib.suppress(OSError):
                self._open(folder / f"delivered-{name}")

    def _open(self, path: Path) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        file = os.open(path, flags, 0o600)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            size = os.fstat(file).st_size // _ENTRY.size * _ENTRY.size
            size = min(max(size, _GROWTH * _ENTRY.size), _MOST_ENTRIES * _ENTRY.size)
            os.ftruncate(file, size)
            self._map = mmap.mmap(file, size)
        except OSError:
            os.close(file)
            raise
        self._file = file
        for slot, (*triple, timestamp) in enumerate(_ENTRY.iter_unpack(self._map)):
            if not any(triple):
                break
            topic = Topic(*triple)
            self._slots[topic] = slot
            self._before[topic] = timestamp

    def is_known(self, topic: Topic, timestamp: int | None) -> bool:
        """Whether the bridge before this one had published the message with that Timestamp last."""
        return timestamp is not None and self._before.get(topic) == timestamp

    def before(self, topic: Topic) -> int | None:
        """The Timestamp of the last message that the bridge before this one had published, or None."""
        return self._before.get(topic)

    def note(self, topic: Topic, timestamp: int | None) -> None:
        """Remember that the message is published now. Callable from any thread."""
        with self._lock:
            if self._map is None or timestamp is None:
                return
            slot = self._slots.get(topic)
            if slot is None:
                self._add(topic, timestamp)
            else:
                _TIMESTAMP.pack_into(self._map, slot * _ENTRY.size + _TIMESTAMP_OFFSET, timestamp)

    def _add(self, topic: Topic, timestamp: int) -> None:
        assert self._map is not None
        slot = len(self._slots)
        if slot >= _MOST_ENTRIES:
            return
        if (slot + 1) * _ENTRY.size > len(self._map):
            self._map.resize(len(self._map) + _GROWTH * _ENTRY.size)
        _ENTRY.pack_into(self._map, slot * _ENTRY.size, *topic, timestamp)
        self._slots[topic] = slot

    def close(self) -> None:
        """Close the file; it stays for the next bridge."""
        with self._lock:
            if self._map is not None:
                self._map.close()
                os.close(self._file)
                self._map = None
