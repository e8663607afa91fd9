"""The files of the audit log: `audit.log`, older ones as `audit.log.1` and so on, and `audit.head`.

Lines are appended at once and synced to the disk by a thread, a few times a second, so that a slow disk does not hold
the server up. After each sync `audit.head` gets the number and the hash of the last line that is safe there: it tells
whether the end of the log is missing.

What a start finds:

    a line without its end        the process was killed, or the power failed, while it was written: the line is cut
                                  off and a line `recovered` says so
    less than `audit.head` knows  lines were removed from the end: the numbers go on behind the missing ones, and a line
                                  `missing` says so
    lines without numbers         they are of an older version: the chain begins behind them

Before the oldest file goes, a line `rotation` says up to which number lines will be gone.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import stat
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import structlog

from ua_fleet.endpoint.audit.chain import BEGIN, ChainLink, digest_of, encode_line, link_of, now_text, parse_line
from ua_fleet.errors import ServerStartError
from ua_fleet.storage.files import make_private_folder

__all__ = ["HEAD_FILE", "ChainedFile", "log_files", "read_head"]

HEAD_FILE: Final = "audit.head"
SYNC_EACH_S: Final = 0.2
"""Lines of so long are synced together."""
WARN_AT: Final = 0.8
"""How full the file is when the warning comes that the next file takes the oldest one's place."""
_HEAD_BYTES: Final = 128
"""All that `audit.head` ever has, so that it is one write into one sector."""
_ROTATION_BYTES: Final = 320
"""Room that is kept for the line `rotation`."""
_TAIL_BYTES: Final = 1024 * 1024

_log = structlog.get_logger("ua_fleet.audit")


def log_files(path: Path) -> list[Path]:
    """The files of a log that are there, the oldest first."""
    prefix = f"{path.name}."
    older: list[tuple[int, Path]] = []
    with contextlib.suppress(OSError):
        for entry in path.parent.iterdir():
            number = entry.name.removeprefix(prefix)
            if entry.name.startswith(prefix) and number.isdecimal() and number.isascii():
                older.append((int(number), entry))
    files = [entry for _, entry in sorted(older, reverse=True)]
    return [*files, path] if path.exists() else files


def read_head(path: Path) -> ChainLink | None:
    """The last line that was safe on the disk, as `audit.head` beside the log says; None where nothing is said."""
    try:
        record = parse_line((path.parent / HEAD_FILE).read_bytes()[:_HEAD_BYTES])
    except OSError:
        return None
    if record is None or not isinstance(record.get("seq"), int) or not isinstance(record.get("hash"), str):
        return None
    return ChainLink(record["seq"], record["hash"])


class ChainedFile:
    """Appends chained lines; mode 600, of bounded size, and nobody else writes at the same time."""

    def __init__(self, path: Path, *, max_bytes: int, backups: int) -> None:
        """Open the log behind its last whole line.

        Args:
            path: of the newest file.
            max_bytes: size at which a new file is begun.
            backups: older files that are kept, one at least.

        Raises:
            ServerStartError: it cannot be written, is no file of this user's alone, or another server has it.
        """
        self._path, self._max_bytes, self._backups = path, max_bytes, backups
        self._file = -1
        self._size = 0
        self._warned = False
        self._unsynced: list[int] = []
        """Files that are full, and not synced yet."""
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._over = threading.Event()
        self._announced = -1
        self.link = BEGIN
        """Where the chain ends."""
        self.found: list[dict[str, Any]] = []
        """What was found wrong at the start, as records to be written."""
        try:
            make_private_folder(path.parent)
            self._head = self._open_head()
            try:
                self._open()
                self._recover()
                self._sync()
            except BaseException:
                os.close(self._head)
                raise
        except OSError as error:
            raise ServerStartError(
                f"{error.filename or path}: cannot write the audit log ({error.strerror}); "
                "set server.state_dir to a folder of this user"
            ) from error
        self._thread = threading.Thread(target=self._keep_syncing, name="audit log", daemon=True)
        self._thread.start()

    def _open_head(self) -> int:
        path = self._path.parent / HEAD_FILE
        descriptor = _open_own(path, os.O_RDWR)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            raise ServerStartError(
                f"{path}: another server writes this audit log; give each its own server.state_dir, or end the other"
            ) from error
        return descriptor

    def _open(self) -> None:
        self._file = _open_own(self._path, os.O_RDWR | os.O_APPEND)
        self._size = os.fstat(self._file).st_size
        self._warned = False

    def _recover(self) -> None:
        """Find the end of the chain."""
        head = read_head(self._path)
        self._cut_torn_line()
        last = _last_line(self._path)
        older = log_files(self._path)[:-1]
        if last is None and older:
            last = _last_line(older[-1])
        if last is not None:
            link = link_of(parse_line(last) or {})
            self.link = ChainLink(link.seq if link is not None else 0, digest_of(last))
        if head is None:
            if self.link.seq:
                self.found.append({"event": "missing", "reason": f"{HEAD_FILE} was not there"})
            return
        if self.link.seq < head.seq:
            gone = head.seq - self.link.seq
            self.found.append({"event": "missing", "lines": gone, "last": head.seq, "last_hash": head.digest})
            _log.error("lines are missing at the end of the audit log", path=str(self._path), lines=gone)
            self.link = ChainLink(head.seq, self.link.digest)
        elif self.link.seq == head.seq and self.link.digest != head.digest:
            self.found.append({"event": "missing", "reason": "the last line was changed", "last_hash": head.digest})
            _log.error("the last line of the audit log was changed", path=str(self._path), line=head.seq)

    def _cut_torn_line(self) -> None:
        start = max(0, self._size - _TAIL_BYTES)
        tail = os.pread(self._file, self._size - start, start)
        if start and b"\n" not in tail:
            start, tail = 0, os.pread(self._file, self._size, 0)
        end = tail.rfind(b"\n") + 1
        if end == len(tail):
            return
        torn = tail[end:]
        os.ftruncate(self._file, start + end)
        self._size = start + end
        self.found.append({"event": "recovered", "torn_bytes": len(torn), "torn_hash": digest_of(torn)})

    def append(self, records: Sequence[Mapping[str, Any]]) -> list[bytes]:
        """Append a line for each record, at once, and return the lines; raises OSError, and then nothing is written."""
        lines, link = _encode(records, self.link)
        size = sum(map(len, lines)) + len(lines)
        if self._file < 0:
            self._open()
        if self._size and self._size + size + _ROTATION_BYTES > self._max_bytes:
            before = self.link
            self._rotate()
            if self.link != before:
                lines, link = _encode(records, self.link)
        self._write(lines, link)
        if not self._warned and self._size > WARN_AT * self._max_bytes:
            self._warn()
        return lines

    def _write(self, lines: Sequence[bytes], link: ChainLink) -> None:
        data = b"".join(line + b"\n" for line in lines)
        try:
            written = os.write(self._file, data)
            if written < len(data):
                raise OSError(28, "No space left on device")
        except OSError:
            # A part of a line would break the chain for all that come after it.
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, self._size)
            raise
        with self._lock:
            self._size += len(data)
            self.link = link
        self._wake.set()

    def _older(self) -> dict[int, Path]:
        """The files before the newest, by their numbers."""
        return {int(file.name.rpartition(".")[2]): file for file in log_files(self._path) if file != self._path}

    def _warn(self) -> None:
        """Say in time what will be gone."""
        self._warned = True
        going = [file.name for number, file in self._older().items() if number >= self._backups]
        if going:
            _log.warning(
                "the audit log is nearly full: its oldest file goes when it is; copy that file away, or raise "
                "server.audit.files",
                folder=str(self._path.parent),
                oldest=", ".join(going),
            )

    def _rotate(self) -> None:
        """Begin a new file. What will be gone is said first: a kill in between removes nothing in silence."""
        older = self._older()
        going = [file for number, file in sorted(older.items(), reverse=True) if number >= self._backups]
        if going:
            last = link_of(parse_line(_last_line(going[-1]) or b"") or {})
            removed_to = last.seq if last is not None else 0
            if removed_to > self._announced:
                self._write(*_encode([{"time": now_text(), "event": "rotation", "removed_to": removed_to}], self.link))
                self._announced = removed_to
        for file in going:
            file.unlink()
        for number in range(self._backups - 1, 0, -1):
            if number in older:
                older[number].replace(self._path.with_name(f"{self._path.name}.{number + 1}"))
        self._path.replace(self._path.with_name(f"{self._path.name}.1"))
        with self._lock:
            self._unsynced.append(self._file)
            self._file = -1
        self._open()

    def _keep_syncing(self) -> None:
        while not self._over.wait(SYNC_EACH_S):
            self._wake.wait()
            self._wake.clear()
            self._sync()

    def _sync(self) -> None:
        """Bring to the disk what has been written, then say so in `audit.head`."""
        with self._lock:
            full, self._unsynced = self._unsynced, []
            current = os.dup(self._file) if self._file >= 0 else -1
            link = self.link
        try:
            for descriptor in [*full, current]:
                if descriptor >= 0:
                    os.fdatasync(descriptor)
            head = json.dumps({"seq": link.seq, "hash": link.digest}).encode()
            os.pwrite(self._head, head.ljust(_HEAD_BYTES - 1) + b"\n", 0)
            os.fdatasync(self._head)
        except OSError as error:
            _log.error("the audit log cannot be synced to the disk", path=str(self._path), reason=error.strerror)
        finally:
            for descriptor in [*full, current]:
                if descriptor >= 0:
                    os.close(descriptor)

    def close(self) -> None:
        """Sync and close; nothing may be written afterwards."""
        self._over.set()
        self._wake.set()
        self._thread.join()
        self._sync()
        if self._file >= 0:
            os.close(self._file)
        os.close(self._head)


def _encode(records: Sequence[Mapping[str, Any]], after: ChainLink) -> tuple[list[bytes], ChainLink]:
    lines: list[bytes] = []
    for record in records:
        line, after = encode_line(record, after)
        lines.append(line)
    return lines, after


def _open_own(path: Path, flags: int) -> int:
    """A file that is nobody else's; raises OSError, or ServerStartError for a link and the like.

    A link would have lines appended, and rights changed, wherever it leads to.
    """
    try:
        descriptor = os.open(path, flags | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK, 0o600)
    except OSError as error:
        if path.is_symlink():
            raise ServerStartError(f"{path}: is a link; the audit log must be a file: remove the link") from error
        raise
    status = os.fstat(descriptor)
    wrong = ""
    if not stat.S_ISREG(status.st_mode):
        wrong = "is no file"
    elif status.st_nlink != 1:
        wrong = f"has {status.st_nlink} names (hard links)"
    elif status.st_uid not in (os.geteuid(), 0, path.parent.stat().st_uid):
        wrong = "belongs to another user"
    if wrong:
        os.close(descriptor)
        raise ServerStartError(f"{path}: {wrong}; the audit log must be a file of this user: move it away")
    os.fchmod(descriptor, 0o600)
    return descriptor


def _last_line(path: Path) -> bytes | None:
    """The last whole line of a file, without its newline."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _TAIL_BYTES))
        lines = file.read().split(b"\n")
    return lines[-2] if len(lines) > 1 else None
