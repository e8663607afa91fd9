"""The journal of Actions in one SQLite file: see `ua_fleet.skill.journal` for what it promises.

Each record is one row, and each method one transaction that is on the disk when the method returns. So a process that
is killed at any moment finds all that had returned, and nothing by halves. What a record may be forgotten, and when,
is decided by the state machines; here it is only done.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final, Self

from ua_fleet.errors import StorageUnavailable
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, Target
from ua_fleet.skill.journal import RecordedExecution, RecordedRequest
from ua_fleet.storage.database import Database

__all__ = ["SqliteJournal"]

_VERSION: Final = 1
_TARGET: Final = """
    publisher_id INTEGER NOT NULL, writer_group_id INTEGER NOT NULL, data_set_writer_id INTEGER NOT NULL,
    action_target_id INTEGER NOT NULL, content BLOB NOT NULL, issued INTEGER NOT NULL, timeout_ms INTEGER NOT NULL,
"""
_SCHEMA: Final = (
    f"""CREATE TABLE requests (
    number INTEGER PRIMARY KEY, execution_id BLOB NOT NULL UNIQUE, {_TARGET}
    outcome TEXT, state INTEGER, status INTEGER, message TEXT, result BLOB) STRICT""",
    f"""CREATE TABLE executions (
    number INTEGER PRIMARY KEY AUTOINCREMENT, execution_id BLOB NOT NULL UNIQUE,
    requestor_id TEXT NOT NULL, space INTEGER NOT NULL, {_TARGET}
    state INTEGER NOT NULL, status INTEGER NOT NULL, message TEXT NOT NULL, result BLOB NOT NULL) STRICT""",
    "CREATE TABLE forgotten (space INTEGER PRIMARY KEY, issued INTEGER NOT NULL) STRICT",
)
_VERSIONS: Final = """CREATE TABLE IF NOT EXISTS request_versions (
    execution_id BLOB PRIMARY KEY, version INTEGER NOT NULL) STRICT"""
"""Made at each opening, since files of version 1 without it are about; a request that is not here says no version."""


class SqliteJournal:
    """A RequestorJournal and a ResponderJournal. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, path: Path) -> None:
        """Open a journal, or begin one; no other process can use it until `close`."""
        self._database = Database(path, version=_VERSION, schema=_SCHEMA)
        self._database.commit((_VERSIONS, ()))

    def close(self) -> None:
        """Give the file free. Safe to call twice."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def requested(self, request: RecordedRequest) -> None:
        """See RequestorJournal."""
        outcome = () if request.outcome is None else _outcome_row(request.outcome)
        row = (
            request.execution_id,
            *request.target,
            request.content,
            request.issued,
            request.timeout_ms,
            *(outcome or (None,) * 5),
        )
        statements = [_insert("requests", _REQUEST_COLUMNS, row)]
        if request.version:
            statements.append(
                _insert("request_versions", "execution_id, version", (request.execution_id, request.version))
            )
        self._database.commit(*statements)

    def withdrawn(self, execution_id: bytes) -> None:
        """See RequestorJournal."""
        self._update("UPDATE requests SET timeout_ms = 0 WHERE execution_id = ?", (execution_id,))

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """See RequestorJournal."""
        self._update(
            "UPDATE requests SET outcome = ?, state = ?, status = ?, message = ?, result = ? WHERE execution_id = ?",
            (*_outcome_row(outcome), execution_id),
        )

    def requests(self) -> Collection[RecordedRequest]:
        """See RequestorJournal."""
        rows = self._database.read(f"SELECT {_REQUEST_COLUMNS} FROM requests ORDER BY issued")  # noqa: S608 - constant
        versions = dict(self._database.read("SELECT execution_id, version FROM request_versions"))
        return [
            request._replace(version=versions.get(request.execution_id, 0)) for request in self._records(_request, rows)
        ]

    def forget_requests(self, execution_ids: Collection[bytes]) -> None:
        """See RequestorJournal."""
        if execution_ids:
            tables = ("requests", "request_versions")
            self._database.commit(*(_delete(table, each) for each in execution_ids for table in tables))

    def recorded(self, execution: RecordedExecution) -> None:
        """See ResponderJournal."""
        row = (
            execution.execution_id,
            execution.requestor_id,
            execution.space,
            *execution.target,
            execution.content,
            execution.issued,
            execution.timeout_ms,
            *_report_row(execution.report),
        )
        self._database.commit(_insert("executions", _EXECUTION_COLUMNS, row))

    def reported(self, execution_id: bytes, report: ExecutionReport) -> None:
        """See ResponderJournal."""
        self._update(
            "UPDATE executions SET state = ?, status = ?, message = ?, result = ? WHERE execution_id = ?",
            (*_report_row(report), execution_id),
        )

    def executions(self) -> Collection[RecordedExecution]:
        """See ResponderJournal."""
        rows = self._database.read(f"SELECT {_EXECUTION_COLUMNS} FROM executions ORDER BY number")  # noqa: S608 - constant
        return self._records(_execution, rows)

    def forget_executions(self, execution_ids: Collection[bytes], forgotten: Mapping[int, int]) -> None:
        """See ResponderJournal."""
        upsert = "INSERT INTO forgotten VALUES (?, ?) ON CONFLICT (space) DO UPDATE SET issued = excluded.issued"
        statements = [_delete("executions", execution_id) for execution_id in execution_ids]
        statements += [(upsert, item) for item in forgotten.items()]
        if statements:
            self._database.commit(*statements)

    def forgotten(self) -> Mapping[int, int]:
        """See ResponderJournal."""
        return dict(self._database.read("SELECT space, issued FROM forgotten"))

    def _update(self, statement: str, values: tuple[Any, ...]) -> None:
        if self._database.commit((statement, values)) != 1:
            raise KeyError(values[-1])

    def _records(self, make: Any, rows: list[tuple[Any, ...]]) -> list[Any]:
        try:
            return [make(row) for row in rows]
        except ValueError as error:  # a number that stands for nothing
            raise StorageUnavailable(
                f"{self._database.path} holds a record that is none ({error}); see what the robots are doing, then move"
                f" the file away"
            ) from error


_TARGET_COLUMNS: Final = "publisher_id, writer_group_id, data_set_writer_id, action_target_id"
_REPORT_COLUMNS: Final = "state, status, message, result"
_REQUEST_COLUMNS: Final = f"execution_id, {_TARGET_COLUMNS}, content, issued, timeout_ms, outcome, {_REPORT_COLUMNS}"
_EXECUTION_COLUMNS: Final = (
    f"execution_id, requestor_id, space, {_TARGET_COLUMNS}, content, issued, timeout_ms, {_REPORT_COLUMNS}"
)


def _insert(table: str, columns: str, row: tuple[Any, ...]) -> tuple[str, tuple[Any, ...]]:
    places = ", ".join("?" * len(row))
    return f"INSERT INTO {table} ({columns}) VALUES ({places})", row  # noqa: S608 - constants of this module


def _delete(table: str, execution_id: bytes) -> tuple[str, tuple[Any, ...]]:
    return f"DELETE FROM {table} WHERE execution_id = ?", (execution_id,)  # noqa: S608 - constants of this module


def _report_row(report: ExecutionReport) -> tuple[Any, ...]:
    return int(report.state), int(report.status), report.message, report.result


def _outcome_row(outcome: RequestOutcome) -> tuple[Any, ...]:
    return str(outcome.kind), *_report_row(outcome.report)


def _report(row: tuple[Any, ...]) -> ExecutionReport:
    state, status, message, result = row
    return ExecutionReport(ExecutionState(state), status, message, result)


def _request(row: tuple[Any, ...]) -> RecordedRequest:
    execution_id, *target, content, issued, timeout_ms, outcome = row[:9]
    known = None if outcome is None else RequestOutcome(OutcomeKind(outcome), _report(row[9:]))
    return RecordedRequest(execution_id, Target(*target), content, issued, timeout_ms, known)


def _execution(row: tuple[Any, ...]) -> RecordedExecution:
    execution_id, requestor_id, space, *target, content, issued, timeout_ms = row[:10]
    return RecordedExecution(
        execution_id, requestor_id, space, Target(*target), content, issued, timeout_ms, _report(row[10:])
    )
