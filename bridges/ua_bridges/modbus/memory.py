"""What a bridge remembers of the executions that it gave to devices: their numbers, and how they ended.

A device knows only the last number that it was given. So the number is on the disk before the device gets it, and the
end is there before it is told.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from ua_fleet.storage.database import Database

__all__ = ["Given", "HandshakeMemory"]

_VERSION: Final = 1
_KEPT: Final = 1000
"""Executions that are remembered."""
_MOST_WITHDRAWN: Final = 1000
"""Numbers of one handshake that are kept; 65,535 have to be left to choose from."""
_WITHDRAWN: Final = """CREATE TABLE IF NOT EXISTS withdrawn (
    place INTEGER PRIMARY KEY AUTOINCREMENT, handshake TEXT NOT NULL, number INTEGER NOT NULL,
    execution_id BLOB NOT NULL UNIQUE) STRICT"""
"""Added to a file of an earlier version, which leaves it alone."""
_SCHEMA: Final = (
    """CREATE TABLE given (
    place INTEGER PRIMARY KEY AUTOINCREMENT, execution_id BLOB NOT NULL UNIQUE, handshake TEXT NOT NULL,
    number INTEGER NOT NULL, before INTEGER NOT NULL, status INTEGER, message TEXT, result BLOB) STRICT""",
)


class Given(NamedTuple):
    """An execution that was given to a device, or was about to be."""

    execution_id: bytes
    handshake: str
    """The device and its request register."""
    number: int
    before: int
    """What the request register had before."""
    status: int | None = None
    """How it ended; None while that is not known."""
    message: str = ""
    result: bytes = b""
    """Packed, see `ua_fleet.skill.executions.pack`."""


class HandshakeMemory:
    """One file of one bridge. Every method raises StorageUnavailable where the disk does not do its part."""

    def __init__(self, path: Path) -> None:
        """Open the file, or begin it."""
        self.is_new = not path.exists()
        """Whether nothing can be known of executions before."""
        self._database = Database(path, version=_VERSION, schema=_SCHEMA)
        self._database.commit((_WITHDRAWN, ()))

    def close(self) -> None:
        """Give the file free. Safe to call twice."""
        self._database.close()

    def give(self, given: Given) -> None:
        """An execution is about to be given to its device."""
        row = (given.execution_id, given.handshake, given.number, given.before)
        self._database.commit(
            ("INSERT INTO given (execution_id, handshake, number, before) VALUES (?, ?, ?, ?)", row),
            ("DELETE FROM given WHERE place <= (SELECT max(place) FROM given) - ?", (_KEPT,)),
        )

    def end(self, execution_id: bytes, status: int, message: str, result: bytes) -> None:
        """An execution has ended."""
        statement = "UPDATE given SET status = ?, message = ?, result = ? WHERE execution_id = ?"
        self._database.commit((statement, (status, message, result, execution_id)))

    def withdraw(self, execution_id: bytes, handshake: str, number: int) -> None:
        """An execution is about to be taken back from its device, which may begin it all the same."""
        values = (handshake, number, execution_id)
        self._database.commit(
            ("INSERT OR IGNORE INTO withdrawn (handshake, number, execution_id) VALUES (?, ?, ?)", values),
            ("DELETE FROM withdrawn WHERE place <= (SELECT max(place) FROM withdrawn) - ?", (_MOST_WITHDRAWN,)),
        )

    def settle(self, handshake: str) -> None:
        """A device has shown that it begins none of what was taken back from it any more."""
        self._database.commit(("DELETE FROM withdrawn WHERE handshake = ?", (handshake,)))

    def withdrawn(self, handshake: str) -> dict[int, bytes]:
        """The execution of each number that was taken back, and that its device may begin yet."""
        rows = self._database.read("SELECT number, execution_id FROM withdrawn WHERE handshake = ?", (handshake,))
        return dict(rows)

    def find(self, execution_id: bytes) -> Given | None:
        """What is remembered of an execution."""
        rows = self._database.read(f"SELECT {_COLUMNS} FROM given WHERE execution_id = ?", (execution_id,))  # noqa: S608 - constant
        return _given(rows)

    def last(self, handshake: str) -> Given | None:
        """The last execution that was given by a handshake."""
        rows = self._database.read(
            f"SELECT {_COLUMNS} FROM given WHERE handshake = ? ORDER BY place DESC LIMIT 1",  # noqa: S608 - constant
            (handshake,),
        )
        return _given(rows)


_COLUMNS: Final = "execution_id, handshake, number, before, status, message, result"


def _given(rows: list[tuple[bytes, str, int, int, int | None, str | None, bytes | None]]) -> Given | None:
    if not rows:
        return None
    execution_id, handshake, number, before, status, message, result = rows[0]
    return Given(execution_id, handshake, number, before, status, message or "", result or b"")
