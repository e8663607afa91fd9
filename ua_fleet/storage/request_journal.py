"""The requests for Actions in the server's file: see `ua_fleet.skill.journal` for what is promised.

Each record is one row, and each method one transaction. What a record may be forgotten, and when, is decided by the
requestor; here it is only done.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import AbstractContextManager
from typing import Any, Final

from ua_fleet.skill.executions import OutcomeKind, RequestOutcome, Target
from ua_fleet.skill.journal import RecordedRequest
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

__all__ = ["REQUEST_COLUMNS", "REQUEST_TABLES", "RequestJournal", "request_statement"]

REQUEST_TABLES: Final = (
    f"""CREATE TABLE requests (
    number INTEGER PRIMARY KEY, execution_id BLOB NOT NULL UNIQUE, {TARGET}
    version INTEGER NOT NULL, outcome TEXT, state INTEGER, status INTEGER, message TEXT, result BLOB) STRICT""",
)
REQUEST_COLUMNS: Final = (
    f"execution_id, {TARGET_COLUMNS}, content, issued, timeout_ms, version, outcome, {REPORT_COLUMNS}"
)


def request_statement(request: RecordedRequest) -> Statement:
    """Records a new request."""
    outcome = (None,) * 5 if request.outcome is None else _outcome_row(request.outcome)
    row = (
        request.execution_id,
        *request.target,
        request.content,
        request.issued,
        request.timeout_ms,
        request.version,
        *outcome,
    )
    return insert("requests", REQUEST_COLUMNS, row)


class RequestJournal:
    """A RequestorJournal. Every method raises StorageUnavailable where it cannot do its part."""

    def __init__(self, database: Database) -> None:
        """Record in a file that has these tables."""
        self._database = database

    def requested(self, request: RecordedRequest) -> None:
        """See RequestorJournal."""
        self._database.commit(request_statement(request))

    def withdrawn(self, execution_id: bytes) -> None:
        """See RequestorJournal."""
        update_one(self._database, "UPDATE requests SET timeout_ms = 0 WHERE execution_id = ?", (execution_id,))

    def concluded(self, execution_id: bytes, outcome: RequestOutcome) -> None:
        """See RequestorJournal."""
        update_one(
            self._database,
            "UPDATE requests SET outcome = ?, state = ?, status = ?, message = ?, result = ? WHERE execution_id = ?",
            (*_outcome_row(outcome), execution_id),
        )

    def requests(self) -> Collection[RecordedRequest]:
        """See RequestorJournal."""
        rows = self._database.read(f"SELECT {REQUEST_COLUMNS} FROM requests ORDER BY issued")  # noqa: S608 - constant
        return valid_records(self._database, _request, rows)

    def forget_requests(self, execution_ids: Collection[bytes]) -> None:
        """See RequestorJournal."""
        if execution_ids:
            self._database.commit(*(delete("requests", each) for each in execution_ids))

    def one_sync(self) -> AbstractContextManager[None]:
        """See RequestorJournal."""
        return self._database.one_sync()

    def settle(self) -> None:
        """See RequestorJournal."""
        self._database.settle()


def _outcome_row(outcome: RequestOutcome) -> tuple[Any, ...]:
    return str(outcome.kind), *report_row(outcome.report)


def _request(row: Sequence[Any]) -> RecordedRequest:
    execution_id, *target, content, issued, timeout_ms, version, outcome = row[:10]
    known = None if outcome is None else RequestOutcome(OutcomeKind(outcome), report_of(row[10:]))
    return RecordedRequest(execution_id, Target(*target), content, issued, timeout_ms, known, version)
