"""Robots that were registered with a server or announced to it, in a SQLite file."""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple, Self

from ua_fleet.storage.database import Database

__all__ = ["REGISTRY_TABLES", "Registry", "StoredRobot"]

_VERSION: Final = 1
REGISTRY_TABLES: Final = (
    """CREATE TABLE robots (
    name TEXT PRIMARY KEY, origin TEXT NOT NULL, bridge TEXT NOT NULL, definition TEXT NOT NULL,
    registered_by TEXT NOT NULL, registered_s REAL NOT NULL) STRICT""",
)


class StoredRobot(NamedTuple):
    """A robot as it was registered."""

    name: str
    origin: str
    """How it came here: `registered` or `announced`."""
    bridge: str
    """Name of a bridge, number of a space, or empty for a robot of clients."""
    definition: str
    """Its text."""
    registered_by: str
    """The user, or the topic that announced it."""
    registered_s: float
    """When, by the wall clock."""


class Registry:
    """These robots. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, file: Path | Database) -> None:
        """Open a registry, or begin one; no other process can use its file until `close`.

        Args:
            file: of its own; or one that is open and has these tables, and is its owner's to close.
        """
        self._owned: Database | None = None
        if isinstance(file, Path):
            file = self._owned = Database(file, version=_VERSION, schema=REGISTRY_TABLES)
        self._database = file

    def close(self) -> None:
        """Give a file of its own free. Safe to call twice."""
        if self._owned is not None:
            self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def put(self, robot: StoredRobot, was: str = "") -> None:
        """Keep a robot, in place of one of the same name, and of the one that it `was` before."""
        gone = [("DELETE FROM robots WHERE name = ?", (was,))] if was else []
        self._database.commit(*gone, ("INSERT OR REPLACE INTO robots VALUES (?, ?, ?, ?, ?, ?)", robot))

    def remove(self, name: str) -> None:
        """Keep a robot no longer."""
        self._database.commit(("DELETE FROM robots WHERE name = ?", (name,)))

    def robots(self) -> list[StoredRobot]:
        """All of them, in the order in which they were registered."""
        rows = self._database.read("SELECT * FROM robots ORDER BY registered_s, name")
        return [StoredRobot(*row) for row in rows]
