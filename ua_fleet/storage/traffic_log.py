"""What one process sends, by kind, as lines of a file; read back over all processes of a fleet."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from ua_fleet.errors import ConfigError
from ua_fleet.topics import Topic
from ua_fleet.traffic import Kind, Traffic

__all__ = ["SentMessage", "TrafficLog", "read_traffic"]


class SentMessage(NamedTuple):
    """One line: a message that was sent."""

    at: float
    """Seconds since 1970."""
    kinds: tuple[Kind, ...]
    """Of each DataSetMessage, request, response, probe or announcement in it."""
    size: int
    """Bytes on the wire, with what security adds, without UDP and IP."""


class TrafficLog:
    """Writes a line for each message as it is sent, so that it is there also when the process is killed."""

    def __init__(self, path: Path, known: Mapping[Topic, Kind]) -> None:
        """Begin a file.

        Args:
            path: replaced if it is there.
            known: see Traffic.

        Raises:
            ConfigError: it cannot be written.
        """
        try:
            self._file = path.open("w", encoding="ascii", buffering=1)
        except OSError as error:
            raise ConfigError(f"cannot write the traffic log: {error.strerror}", file=str(path)) from error
        self._traffic = Traffic(known)

    def sent(self, plain: bytes, wire_bytes: int, at: float) -> None:
        """Take a message that was sent at this time, in seconds since 1970; see `Traffic.take`."""
        kinds = self._traffic.take(plain, wire_bytes, at)
        line = {"t": round(at, 4), "kinds": kinds, "bytes": wire_bytes}
        # A full disk must not stop a bridge: the log is for people.
        with suppress(OSError):
            self._file.write(json.dumps(line) + "\n")

    def close(self) -> None:
        """Close the file."""
        with suppress(OSError):
            self._file.close()


def read_traffic(paths: Iterable[Path]) -> list[SentMessage]:
    """The messages of some logs in the order in which they were sent. A last line that is not complete is left out."""
    messages: list[SentMessage] = []
    for path in paths:
        for line in path.read_text(encoding="ascii").splitlines():
            with suppress(ValueError):
                said = json.loads(line)
                messages.append(SentMessage(said["t"], tuple(Kind(kind) for kind in said["kinds"]), said["bytes"]))
    return sorted(messages)
