"""What the Modbus device remembers over a restart: its last command, and the numbers of decisions."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from ua_fleet.modbus.words import CommandState
from ua_fleet.storage.database import Database

__all__ = ["CommandMemory", "LastCommand"]

_VERSION: Final = 1
_KEPT: Final = 1000
_SCHEMA: Final = (
    """CREATE TABLE command (
    place INTEGER PRIMARY KEY CHECK (place = 0), number INTEGER NOT NULL, code INTEGER NOT NULL,
    state INTEGER NOT NULL, begun TEXT NOT NULL, status INTEGER NOT NULL, message TEXT NOT NULL,
    results TEXT NOT NULL) STRICT""",
    "CREATE TABLE decisions (number INTEGER PRIMARY KEY AUTOINCREMENT, decision_id TEXT NOT NULL UNIQUE) STRICT",
)


class LastCommand(NamedTuple):
    """The command that the answer words are about."""

    number: int
    code: int
    state: CommandState
    begun: str = ""
    """Id of the execution or the run."""
    status: int = 0
    message: str = ""
    results: str = ""
    """A JSON object."""


class CommandMemory:
    """One file. Every method raises StorageUnavailable where the disk does not do its part."""

    def __init__(self, path: Path) -> None:
        """Open the file, or begin it."""
        self._database = Database(path, version=_VERSION, schema=_SCHEMA)

    def close(self) -> None:
        """Give the file free."""
        self._database.close()

    def last(self) -> LastCommand | None:
        """The last command."""
        rows = self._database.read("SELECT number, code, state, begun, status, message, results FROM command")
        if not rows:
            return None
        number, code, state, *rest = rows[0]
        return LastCommand(number, code, CommandState(state), *rest)

    def record(self, command: LastCommand) -> None:
        """The last command, or its new state; on the disk when this returns."""
        self._database.commit(("INSERT OR REPLACE INTO command VALUES (0, ?, ?, ?, ?, ?, ?, ?)", command))

    def decision_number(self, decision_id: str) -> int:
        """The number of a decision, 1 to 65535; a new one where it has none yet."""
        rows = self._database.read("SELECT number FROM decisions WHERE decision_id = ?", (decision_id,))
        if not rows:
            self._database.commit(
                ("INSERT INTO decisions (decision_id) VALUES (?)", (decision_id,)),
                ("DELETE FROM decisions WHERE number <= (SELECT max(number) FROM decisions) - ?", (_KEPT,)),
            )
            rows = self._database.read("SELECT number FROM decisions WHERE decision_id = ?", (decision_id,))
        return (int(rows[0][0]) - 1) % 0xFFFF + 1
