"""The journal of scenario runs and faults in one SQLite file, with what users have set.

Facts that belong together are one transaction, on the disk when `write` returns: what they ask of robots is carried out
after that alone. So a process that is killed at any moment finds all that robots were ever asked for.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final, NamedTuple, Self

from ua_fleet.errors import StorageUnavailable
from ua_fleet.orchestrator import Fault, Halt, HaltChanged, Hold, HoldChanged
from ua_fleet.scenario.facts import Fact, RunEnded, decode_fact, encode_fact
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest
from ua_fleet.storage.action_rows import delete
from ua_fleet.storage.database import Database, Statement
from ua_fleet.storage.journal import execution_statement
from ua_fleet.storage.request_journal import request_statement

__all__ = ["RUN_TABLES", "RunJournal", "StoredRun", "StoredSetting"]

_VERSION: Final = 1
_SCHEMA: Final = (
    """CREATE TABLE runs (
    number INTEGER PRIMARY KEY AUTOINCREMENT, run_id TEXT NOT NULL UNIQUE, ended INTEGER NOT NULL) STRICT""",
    "CREATE TABLE facts (number INTEGER PRIMARY KEY AUTOINCREMENT, run_id TEXT NOT NULL, line TEXT NOT NULL) STRICT",
    "CREATE INDEX facts_of_run ON facts (run_id, number)",
    """CREATE TABLE faults (robot TEXT NOT NULL, source TEXT NOT NULL, reason TEXT NOT NULL, active INTEGER NOT NULL,
    acknowledged INTEGER NOT NULL, since REAL NOT NULL, acknowledged_by TEXT NOT NULL, PRIMARY KEY (robot, source))
    STRICT""",
)
_SETTINGS: Final = """CREATE TABLE IF NOT EXISTS settings (name TEXT PRIMARY KEY, value TEXT NOT NULL,
    instead_of TEXT NOT NULL, set_by TEXT NOT NULL, set_at REAL NOT NULL) STRICT"""
"""Made at each opening, since files of version 1 without it are about."""

_FAULT_CAPACITIES: Final = """CREATE TABLE IF NOT EXISTS fault_capacities (robot TEXT NOT NULL, source TEXT NOT NULL,
    capacities TEXT NOT NULL, PRIMARY KEY (robot, source)) STRICT"""
"""Likewise. A fault that is not here takes all capacities away: so an earlier version reads them all."""

_HALTS: Final = """CREATE TABLE IF NOT EXISTS halts (execution_id TEXT PRIMARY KEY, robot TEXT NOT NULL,
    skill TEXT NOT NULL, since REAL NOT NULL) STRICT"""
"""Likewise. An earlier version leaves them alone."""

_HALT_REASONS: Final = """CREATE TABLE IF NOT EXISTS halt_reasons (execution_id TEXT PRIMARY KEY, why TEXT NOT NULL)
    STRICT"""
"""Likewise."""

_HOLDS: Final = """CREATE TABLE IF NOT EXISTS holds (robot TEXT PRIMARY KEY, held_by TEXT NOT NULL, since REAL NOT NULL,
    reason TEXT NOT NULL) STRICT"""
"""Likewise."""

_ADDITIONS: Final = (_SETTINGS, _FAULT_CAPACITIES, _HALTS, _HALT_REASONS, _HOLDS)
RUN_TABLES: Final = (*_SCHEMA, *_ADDITIONS)


class StoredRun(NamedTuple):
    """A run of the journal."""

    run_id: str
    ended: bool


class StoredSetting(NamedTuple):
    """What a user has set in place of what the configuration says."""

    value: str
    instead_of: str
    """What the configuration said then."""
    by: str
    at: float


class RunJournal:
    """Runs in the order in which they began. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, file: Path | Database) -> None:
        """Open a journal, or begin one; no other process can use its file until `close`.

        Args:
            file: of its own; or one that is open and has these tables, and is its owner's to close.
        """
        self._owned: Database | None = None
        if isinstance(file, Path):
            file = self._owned = Database(file, version=_VERSION, schema=_SCHEMA, additions=_ADDITIONS)
        self._database = file

    def close(self) -> None:
        """Give a file of its own free. Safe to call twice."""
        if self._owned is not None:
            self._owned.close()

    def one_sync(self) -> AbstractContextManager[None]:
        """Have all that is written within synced once, before anything of it leaves the process; see Database."""
        return self._database.one_sync()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(
        self,
        facts: Iterable[tuple[str, Fact]],
        faults: Iterable[Fault] = (),
        halts: Iterable[HaltChanged] = (),
        holds: Iterable[HoldChanged] = (),
        requests: Iterable[RecordedRequest | RecordedExecution] = (),
        unasked: Iterable[bytes] = (),
    ) -> None:
        """Write what belongs together: all or nothing.

        Args:
            facts: of runs, in their order.
            faults: how they are.
            halts: what robots are to stop, or have stopped.
            holds: who is held, or is not any more.
            requests: to bridges and to clients, for what the facts say that robots are to do.
            unasked: executions with such a request that was not sent, and never will be: it is forgotten.
        """
        statements: list[Statement] = []
        for run_id, fact in facts:
            statements.append(("INSERT OR IGNORE INTO runs (run_id, ended) VALUES (?, 0)", (run_id,)))
            statements.append(("INSERT INTO facts (run_id, line) VALUES (?, ?)", (run_id, encode_fact(fact))))
            if isinstance(fact, RunEnded):
                statements.append(("UPDATE runs SET ended = 1 WHERE run_id = ?", (run_id,)))
        statements += [statement for fault in faults for statement in _of_fault(fault)]
        statements += [statement for changed in halts for statement in _of_halt(changed)]
        statements += [_of_hold(change) for change in holds]
        statements += [_of_request(request) for request in requests]
        statements += [delete(table, each) for each in unasked for table in ("requests", "executions")]
        if statements:
            self._database.commit(*statements)

    def runs(self) -> list[StoredRun]:
        """All runs, the oldest first."""
        rows = self._database.read("SELECT run_id, ended FROM runs ORDER BY number")
        return [StoredRun(run_id, bool(ended)) for run_id, ended in rows]

    def facts(self, run_id: str) -> list[Fact]:
        """The facts of a run, in order; none where there is no such run."""
        rows = self._database.read("SELECT line FROM facts WHERE run_id = ? ORDER BY number", (run_id,))
        try:
            return [decode_fact(line) for (line,) in rows]
        except ValueError as error:
            raise StorageUnavailable(
                f"{self._database.path} holds a fact of run {run_id} that is none ({error}); see what the robots are"
                f" doing, then move the file away"
            ) from error

    def forget(self, run_id: str, lines: Collection[str]) -> None:
        """Forget some facts of a run, given as their lines; those that are not there cost nothing."""
        rows = self._database.read("SELECT number, line FROM facts WHERE run_id = ?", (run_id,))
        past = set(lines)
        if statements := [("DELETE FROM facts WHERE number = ?", (number,)) for number, line in rows if line in past]:
            self._database.commit(*statements)

    def faults(self) -> list[Fault]:
        """The faults that were active, or not acknowledged."""
        rows = self._database.read(
            "SELECT robot, source, reason, active, acknowledged, since, acknowledged_by, capacities FROM faults"
            " LEFT JOIN fault_capacities USING (robot, source) ORDER BY since"
        )
        return [
            Fault(
                f"{robot}.{source}",
                robot,
                source,
                reason,
                bool(active),
                bool(acknowledged),
                since,
                by,
                tuple(capacities.split()) if capacities else (),
            )
            for robot, source, reason, active, acknowledged, since, by, capacities in rows
        ]

    def halts(self) -> list[Halt]:
        """What robots were told to stop, and have not said that they have."""
        rows = self._database.read(
            "SELECT execution_id, robot, skill, since, coalesce(why, '') FROM halts"
            " LEFT JOIN halt_reasons USING (execution_id) ORDER BY since"
        )
        return [Halt(*row) for row in rows]

    def holds(self) -> list[Hold]:
        """The robots that people hold back from tasks, the longest first."""
        rows = self._database.read("SELECT robot, held_by, since, reason FROM holds ORDER BY since")
        return [Hold(*row) for row in rows]

    def settings(self) -> dict[str, StoredSetting]:
        """What users have set, by its name."""
        rows = self._database.read("SELECT name, value, instead_of, set_by, set_at FROM settings ORDER BY name")
        return {name: StoredSetting(*setting) for name, *setting in rows}

    def keep_setting(self, name: str, setting: StoredSetting) -> None:
        """Keep a setting in place of the one before."""
        self._database.commit(("INSERT OR REPLACE INTO settings VALUES (?, ?, ?, ?, ?)", (name, *setting)))

    def forget_setting(self, name: str) -> None:
        """The configuration counts again."""
        self._database.commit(("DELETE FROM settings WHERE name = ?", (name,)))

    def prune(self, kept: int) -> list[str]:
        """Forget all but the last `kept` runs that have ended; the ids of those that were forgotten."""
        ended = [run.run_id for run in self.runs() if run.ended]
        forgotten = ended[: max(0, len(ended) - kept)]
        statements: list[Statement] = []
        for run_id in forgotten:
            statements.append(("DELETE FROM facts WHERE run_id = ?", (run_id,)))
            statements.append(("DELETE FROM runs WHERE run_id = ?", (run_id,)))
        if statements:
            self._database.commit(*statements)
        return forgotten


def _of_fault(fault: Fault) -> list[Statement]:
    key = fault.robot, fault.source
    statements: list[Statement] = [("DELETE FROM fault_capacities WHERE robot = ? AND source = ?", key)]
    if not fault.active and fault.acknowledged:
        return [*statements, ("DELETE FROM faults WHERE robot = ? AND source = ?", key)]
    statements.append(
        (
            "INSERT OR REPLACE INTO faults VALUES (?, ?, ?, ?, ?, ?, ?)",
            (
                *key,
                fault.reason,
                int(fault.active),
                int(fault.acknowledged),
                fault.since,
                fault.acknowledged_by,
            ),
        )
    )
    if fault.capacities:  # names without blanks, as fleet.yaml has them
        row = (*key, " ".join(fault.capacities))
        statements.append(("INSERT INTO fault_capacities VALUES (?, ?, ?)", row))
    return statements


def _of_halt(changed: HaltChanged) -> list[Statement]:
    halt = changed.halt
    if not changed.is_owed:
        return [
            ("DELETE FROM halt_reasons WHERE execution_id = ?", (halt.execution_id,)),
            ("DELETE FROM halts WHERE execution_id = ?", (halt.execution_id,)),
        ]
    row = (halt.execution_id, halt.robot, halt.skill, halt.since)
    return [
        ("INSERT OR REPLACE INTO halts VALUES (?, ?, ?, ?)", row),
        ("INSERT OR REPLACE INTO halt_reasons VALUES (?, ?)", (halt.execution_id, halt.why)),
    ]


def _of_hold(changed: HoldChanged) -> Statement:
    hold = changed.hold
    if not changed.is_held:
        return "DELETE FROM holds WHERE robot = ?", (hold.robot,)
    return "INSERT OR REPLACE INTO holds VALUES (?, ?, ?, ?)", (hold.robot, hold.by, hold.since, hold.reason)


def _of_request(request: RecordedRequest | RecordedExecution) -> Statement:
    if isinstance(request, RecordedExecution):
        return execution_statement(request)
    return request_statement(request)
