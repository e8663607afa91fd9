"""The states of alarms in the file of a server: each change is in the commit that is done before it is told."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

from ua_fleet.storage.database import Database

__all__ = ["ALARM_TABLES", "AlarmStates", "StoredAlarm"]

ALARM_TABLES: Final = (
    """CREATE TABLE IF NOT EXISTS alarms (id TEXT PRIMARY KEY, enabled INTEGER NOT NULL, level INTEGER NOT NULL,
    since REAL NOT NULL, acked INTEGER NOT NULL, confirmed INTEGER NOT NULL, severity INTEGER NOT NULL,
    last_severity INTEGER NOT NULL, shelving TEXT NOT NULL, unshelve_at REAL, suppressed INTEGER NOT NULL,
    quality INTEGER NOT NULL, comment TEXT NOT NULL, comment_by TEXT NOT NULL, comment_at REAL, message TEXT NOT NULL,
    event_id BLOB NOT NULL, told_at REAL NOT NULL) STRICT""",
)
"""Made at each opening, since files of version 1 without it are about; an earlier version leaves it alone."""


class StoredAlarm(NamedTuple):
    """An alarm as it was; see `operation.alarms.condition`."""

    id: str
    enabled: int
    level: int
    since: float
    acked: int
    confirmed: int
    severity: int
    last_severity: int
    shelving: str
    unshelve_at: float | None
    suppressed: int
    quality: int
    comment: str
    comment_by: str
    comment_at: float | None
    message: str
    event_id: bytes
    told_at: float


_PUT: Final = f"INSERT OR REPLACE INTO alarms VALUES ({', '.join('?' * len(StoredAlarm._fields))})"  # noqa: S608 - constants


class AlarmStates:
    """These states. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, database: Database) -> None:
        """Use a file that is open and has these tables, and is its owner's to close."""
        self._database = database

    def put(self, states: Iterable[StoredAlarm]) -> None:
        """Keep states in place of those before: all of them or none."""
        if statements := [(_PUT, state) for state in states]:
            self._database.commit(*statements)

    def states(self) -> list[StoredAlarm]:
        """All that are kept."""
        return [StoredAlarm(*row) for row in self._database.read("SELECT * FROM alarms ORDER BY id")]
