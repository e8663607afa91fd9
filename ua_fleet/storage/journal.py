"""The executions of Actions in a SQLite file: see `ua_fleet.skill.journal` for what is promised.

Each record is one row, and each method one transaction that is on the disk when the method returns, or with the next
`settle` where the file's owner has several synced once. So a process that is killed at any moment finds all that had
returned, and nothing by halves. What a record may be forgotten, and when,
is decided by the state machines; here it is only done.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

from ua_fleet.skill.executions import ExecutionReport, Target
from ua_fleet.skill.journal import RecordedExecution
from ua_fleet.storage.action_rows import (
    REPORT_COLUMNS,
    TARGET,
    TARGET_COLUMNS,
    delete,
    insert,
    report_of,
    report_row,
    update_one,
    valid_records,
)
from ua_fleet.storage.database import Database, Statement

__all__ = ["EXECUTION_COLUMNS", "EXECUTION_TABLES", "SqliteJournal", "execution_statement"]

_VERSION: Final = 1
EXECUTION_TABLES: Final = (
    f"""CREATE TABLE executions (
    number INTEGER PRIMARY KEY AUTOINCREMENT, execution_id BLOB NOT NULL UNIQUE,
    requestor_id TEXT NOT NULL, space INTEGER NOT NULL, {TARGET}
    state INTEGER NOT NULL, status INTEGER NOT NULL, message TEXT NOT NULL, result BLOB NOT NULL) STRICT""",
    "CREATE TABLE forgotten (space INTEGER PRIMARY KEY, issued INTEGER NOT NULL) STRICT",
)
_SCHEMA: Final = (
    f"""CREATE TABLE requests (
    number INTEGER PRIMARY KEY, execution_id BLOB NOT NULL UNIQUE, {TARGET}
    outcome TEXT, state INTEGER, status INTEGER, message TEXT, result BLOB) STRICT""",
    *EXECUTION_TABLES,
)
"""Of a file of its own. Servers had their requests in one, so this table belongs to version 1; nothing is put into it
any more."""
_VERSIONS: Final = """CREATE TABLE IF NOT EXISTS request_versions (
    execution_id BLOB PRIMARY KEY, version INTEGER NOT NULL) STRICT"""
"""Likewise; made at each opening, since files of version 1 without it are about."""
EXECUTION_COLUMNS: Final = (
    f"execution_id, requestor_id, space, {TARGET_COLUMNS}, content, issued, timeout_ms, {REPORT_COLUMNS}"
)


def execution_statement(execution: RecordedExecution) -> Statement:
    """Records a new execution."""
    row = (
        execution.execution_id,
        execution.requestor_id,
        execution.space,
        *execution.target,
        execution.content,
        execution.issued,
        execution.timeout_ms,
        *report_row(execution.report),
    )
    return insert("executions", EXECUTION_COLUMNS, row)


class SqliteJournal:
    """A ResponderJournal. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, file: Path | Database) -> None:
        """Open a journal, or begin one; no other process can use its file until `close`.

        Args:
            file: of its own; or one that is open and has these tables, and is its owner's to close.
        """
        self._owned: Database | None = None
        if isinstance(file, Path):
            file = self._owned = Database(
                file, version=_VERSION, schema=_SCHEMA, additions=(_VERSIONS,), is_prompt=True
            )
        self._database = file

    def close(self) -> None:
        """Give a file of its own free. Safe to call twice."""
        if self._owned is not None:
            self._owned.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def recorded(self, execution: RecordedExecution) -> None:
        """See ResponderJournal."""
        self._database.commit(execution_statement(execution))

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        """See ResponderJournal."""
        update_one(
            self._database,
            "UPDATE executions SET state = ?, status = ?, message = ?, result = ? WHERE execution_id = ?",
            (*report_row(report), execution_id),
        )

    def executions(self) -> Collection[RecordedExecution]:
        """See ResponderJournal."""
        rows = self._database.read(f"SELECT {EXECUTION_COLUMNS} FROM executions ORDER BY number")  # noqa: S608 - constant
        return valid_records(self._database, _execution, rows)

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        """See ResponderJournal."""
        upsert = "INSERT INTO forgotten VALUES (?, ?) ON CONFLICT (space) DO UPDATE SET issued = excluded.issued"
        statements = [delete("executions", execution_id) for execution_id in execution_ids]
        statements += [(upsert, item) for item in forgotten.items()]
        if statements:
            self._database.commit(*statements)

    def forgotten(self) -> Mapping[int, int]:
        """See ResponderJournal."""
        return dict(self._database.read("SELECT space, issued FROM forgotten"))

    def settle(self) -> None:
        """See ResponderJournal."""
        self._database.settle()


def _execution(row: Sequence[Any]) -> RecordedExecution:
    execution_id, requestor_id, space, *target, content, issued, timeout_ms = row[:10]
    return RecordedExecution(
        execution_id, requestor_id, space, Target(*target), content, issued, timeout_ms, report_of(row[10:])
    )
