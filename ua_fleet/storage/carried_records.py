"""What a bridge records of the runs that it carries, in one SQLite file: its facts of them, the runs of their segments,
what it has asked robots to do, and what its own robots were asked so. One sync puts all of it on the disk.

A fact is on the disk when `note` returns. The facts of segments are kept until their run is forgotten: the server
fetches them, which may have been away for all of the run. Of rounds of a `repeat` that are over, the last ones are.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final, Self

from ua_fleet.carrying.compacting import forgotten_segments, superseded
from ua_fleet.carrying.facts import CarryFact, RunClosed, decode_carry_fact, encode_carry_fact
from ua_fleet.carrying.held import HeldRun
from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.database import Database, Statement
from ua_fleet.storage.journal import EXECUTION_TABLES, SqliteJournal
from ua_fleet.storage.request_journal import REQUEST_TABLES, RequestJournal
from ua_fleet.storage.run_journal import RUN_TABLES, RunJournal

__all__ = ["CARRIED_FILE", "CARRIED_TABLES", "OPEN_CARRIED", "CarriedRecords"]

CARRIED_FILE: Final = "carried.db"
"""In a bridge's `state_dir`."""
_VERSION: Final = 1
_FORGET_SEGMENT: Final = ("DELETE FROM facts WHERE run_id = ?", "DELETE FROM runs WHERE run_id = ?")
_FACTS: Final = (
    "CREATE TABLE carried (number INTEGER PRIMARY KEY AUTOINCREMENT, run_id TEXT NOT NULL, line TEXT NOT NULL) STRICT",
    "CREATE INDEX carried_of_run ON carried (run_id, number)",
)
CARRIED_TABLES: Final = (*_FACTS, *REQUEST_TABLES, *EXECUTION_TABLES, *RUN_TABLES)
OPEN_CARRIED: Final = (
    "SELECT DISTINCT run_id FROM carried WHERE run_id NOT IN"  # noqa: S608 - constant
    f""" (SELECT run_id FROM carried WHERE line LIKE '{{"fact": "{RunClosed.__name__}"%')"""
)
"""The ids of the runs that are not over; what cannot be decoded closes none."""


class _KeptRuns(RunJournal):
    """Forgets no segment by itself: its run may go on, or be asked about."""

    def prune(self, kept: int) -> list[str]:
        """Nothing is forgotten."""
        del kept
        return []


class _OwnRequests(RequestJournal):
    """Most requests stay in the process: who sends one out of it settles first."""

    def settle(self) -> None:
        """Nothing leaves the process with this."""


class CarriedRecords:
    """The file of one bridge. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, place: Path | Database) -> None:
        """Open it, or begin one; no other process can use it until `close`.

        Args:
            place: the bridge's `state_dir`; or a file that is open and has CARRIED_TABLES.
        """
        if isinstance(place, Path):
            # A bridge that gets its first part makes the file amid its work: then the log grows to its length.
            file = place / CARRIED_FILE
            place = Database(file, version=_VERSION, schema=CARRIED_TABLES, is_prompt=file.exists())
        self._database = place
        self.runs: RunJournal = _KeptRuns(self._database)
        """Of segments."""
        self.requests: RequestJournal = _OwnRequests(self._database)
        """What robots were asked to do for them; its `settle` does nothing, that of this does."""
        self.executions = SqliteJournal(self._database)
        """What the bridge's own robots were asked so."""

    def close(self) -> None:
        """Give the file free. Safe to call twice."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def one_sync(self) -> AbstractContextManager[None]:
        """Have all that is written within synced once, before anything of it leaves the process; see Database."""
        return self._database.one_sync()

    def settle(self) -> None:
        """Have all that was written on the disk when this returns."""
        self._database.settle()

    def note(self, fact: CarryFact) -> None:
        """Write a fact down."""
        statement = "INSERT INTO carried (run_id, line) VALUES (?, ?)"
        self._database.commit((statement, (fact.run_id, encode_carry_fact(fact))))

    def facts(self) -> list[CarryFact]:
        """All facts, in the order in which they were written."""
        try:
            rows = self._database.read("SELECT line FROM carried ORDER BY number")
            return [decode_carry_fact(line) for (line,) in rows]
        except ValueError as error:
            raise StorageUnavailable(
                f"{self._database.path} holds a fact of a carried run that is none ({error}); see what the robots are"
                " doing, then move the file away"
            ) from error

    def segments_of(self, run_id: str) -> list[str]:
        """The ids under which segments of a run were run, in the order in which they began."""
        statement = "SELECT run_id FROM runs WHERE run_id > ? AND run_id < ? ORDER BY number"
        rows = self._database.read(statement, _around_segments(run_id))
        return [found for (found,) in rows]

    def last_number(self) -> int:
        """The highest number that a fact of a segment has had, also where it was forgotten since; 0: there was none."""
        rows = self._database.read("SELECT seq FROM sqlite_sequence WHERE name = 'facts'")
        return int(rows[0][0]) if rows else 0

    def lines_beyond(self, run_id: str, last: int) -> Iterator[tuple[int, str]]:
        """The lines of facts of all segments of a run in the order in which they were written, each with its number.

        Those after the one with the number `last`, where 0 is before all. Other runs have numbers between.
        """
        # By the primary key: what follows a line is found at once, and nothing is sorted.
        statement = (
            "SELECT number, line FROM facts NOT INDEXED WHERE number > ? AND substr(run_id, 1, ?) = ? ORDER BY number"
        )
        head = f"{run_id}."
        return ((number, line) for number, line in self._database.rows(statement, (last, len(head), head)))

    def compact(self, held: HeldRun, kept: int) -> int:
        """Forget what a run needs no more, and all but the last segments of rounds that are over; how many lines.

        Args:
            held: the run, as its facts have made it.
            kept: so many segments of such rounds stay, for the server.
        """
        run_id = held.part.run_id
        rows = self._database.read("SELECT number, line FROM carried WHERE run_id = ? ORDER BY number", (run_id,))
        over = superseded(held, [decode_carry_fact(line) for _, line in rows])
        statement = "SELECT run_id FROM runs WHERE ended = 1 AND run_id > ? AND run_id < ? ORDER BY number"
        ended = self._database.read(statement, _around_segments(run_id))
        segments = forgotten_segments(held, [segment for (segment,) in ended])
        segments = segments[: max(0, len(segments) - kept)]
        statements: list[Statement] = [("DELETE FROM carried WHERE number = ?", (rows[at][0],)) for at in over]
        statements += [(statement, (one,)) for one in segments for statement in _FORGET_SEGMENT]
        if statements:
            self._database.commit(*statements)
        return len(statements)

    def forget(self, run_id: str) -> None:
        """Forget a run with its segments."""
        segments = _around_segments(run_id)
        self._database.commit(
            ("DELETE FROM facts WHERE run_id > ? AND run_id < ?", segments),
            ("DELETE FROM runs WHERE run_id > ? AND run_id < ?", segments),
            ("DELETE FROM carried WHERE run_id = ?", (run_id,)),
        )


def _around_segments(run_id: str) -> tuple[str, str]:
    """What the ids of a run's segments are between, so that an index finds them; `/` is the character behind `.`."""
    return f"{run_id}.", f"{run_id}/"
