"""What one process sends, by kind, as lines of a file; read back over all processes of a fleet."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple, TextIO

from ua_fleet.errors import ConfigError
from ua_fleet.topics import Topic
from ua_fleet.traffic import MessageKind, Traffic

__all__ = ["SentMessage", "TrafficLog", "read_traffic"]

MOST_BYTES: Final = 16 * 1024 * 1024
"""Some hours of a bridge's messages."""


class SentMessage(NamedTuple):
    """One line: a message that was sent."""

    at: float
    """Seconds since 1970."""
    kinds: tuple[MessageKind, ...]
    """Of each DataSetMessage, request, response, probe or announcement in it."""
    size: int
    """Bytes on the wire, with what security adds, without UDP and IP."""


class TrafficLog:
    """Writes a line for each message as it is sent, so that it is there also when the process is killed."""

    def __init__(self, path: Path, known: Mapping[Topic, MessageKind], *, most_bytes: int = MOST_BYTES) -> None:
        """Go on with a file, or begin it.

        Args:
            path: where there is one already, it is gone on with.
            known: see Traffic.
            most_bytes: of the file; then it is kept as `<name>.1`, in place of the one before, and begun anew.

        Raises:
            ConfigError: it cannot be written.
        """
        self._path, self._most_bytes = path, most_bytes
        try:
            self._file = self._open()
        except OSError as error:
            raise ConfigError(f"cannot write the traffic log: {error.strerror}", file=str(path)) from error
        self._traffic = Traffic(known)

    def _open(self) -> TextIO:
        file = self._path.open("a", encoding="ascii", buffering=1)
        self._bytes = file.tell()
        if self._bytes:
            file.write("\n")  # a process that was killed may have left half a line
        return file

    def sent(self, plain: bytes, wire_bytes: int, at: float) -> None:
        """Take a message that was sent at this time, in seconds since 1970; see `Traffic.take`."""
        kinds = self._traffic.take(plain, wire_bytes, at)
        line = {"t": round(at, 4), "kinds": kinds, "bytes": wire_bytes}
        # A full disk must not stop a bridge: the log is for people.
        with suppress(OSError):
            self._bytes += self._file.write(json.dumps(line) + "\n")
            if self._bytes > self._most_bytes:
                self._begin_anew()

    def _begin_anew(self) -> None:
        """Keep the file and begin another one; where that fails the old one goes on."""
        with suppress(FileNotFoundError):  # somebody has removed it
            self._path.replace(self._path.with_name(f"{self._path.name}.1"))
        full, self._file = self._file, self._open()
        full.close()

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):
            self._file.close()


def read_traffic(paths: Iterable[Path]) -> list[SentMessage]:
    """The messages of some logs in the order in which they were sent.

    Lines that are not whole are left out, and so is a file that has just got another name.
    """
    messages: list[SentMessage] = []
    for path in paths:
        with suppress(FileNotFoundError):
            for line in path.read_text(encoding="ascii", errors="replace").splitlines():
                with suppress(ValueError, KeyError, TypeError):
                    said = json.loads(line)
                    messages.append(
                        SentMessage(said["t"], tuple(MessageKind(kind) for kind in said["kinds"]), said["bytes"])
                    )
    return sorted(messages)
