"""Records of Actions as rows: what the tables of requests and of executions have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, TypeVar

from ua_fleet.errors import StorageUnavailable
from ua_fleet.skill.executions import ExecutionReport, ExecutionState
from ua_fleet.storage.database import Database, Statement

__all__ = [
    "REPORT_COLUMNS",
    "TARGET",
    "TARGET_COLUMNS",
    "delete",
    "insert",
    "report_of",
    "report_row",
    "update_one",
    "valid_records",
]

_Record = TypeVar("_Record")

TARGET: Final = """
    publisher_id INTEGER NOT NULL, writer_group_id INTEGER NOT NULL, data_set_writer_id INTEGER NOT NULL,
    action_target_id INTEGER NOT NULL, content BLOB NOT NULL, issued INTEGER NOT NULL, timeout_ms INTEGER NOT NULL,
"""
TARGET_COLUMNS: Final = "publisher_id, writer_group_id, data_set_writer_id, action_target_id"
REPORT_COLUMNS: Final = "state, status, message, result"


def insert(table: str, columns: str, row: Sequence[Any]) -> Statement:
    """Puts in a row; table and columns are constants of this room."""
    places = ", ".join("?" * len(row))
    return f"INSERT INTO {table} ({columns}) VALUES ({places})", row  # noqa: S608 - see above


def delete(table: str, execution_id: bytes) -> Statement:
    """Takes a row away; the table is a constant of this room."""
    return f"DELETE FROM {table} WHERE execution_id = ?", (execution_id,)  # noqa: S608 - see above


def update_one(database: Database, statement: str, values: Sequence[Any]) -> None:
    """Change one row; KeyError with the last value where there is none."""
    if database.commit((statement, values)) != 1:
        raise KeyError(values[-1])


def report_row(report: ExecutionReport) -> tuple[Any, ...]:
    """A report in the order of its columns."""
    return int(report.state), int(report.status), report.message, report.result


def report_of(row: Sequence[Any]) -> ExecutionReport:
    """The report of a row; ValueError where its state is none."""
    state, status, message, result = row
    return ExecutionReport(ExecutionState(state), status, message, result)


def valid_records(database: Database, make: Callable[[Sequence[Any]], _Record], rows: list[Any]) -> list[_Record]:
    """The records of rows.

    Raises:
        StorageUnavailable: one holds a number that stands for nothing.
    """
    try:
        return [make(row) for row in rows]
    except ValueError as error:
        raise StorageUnavailable(
            f"{database.path} holds a record that is none ({error}); see what the robots are doing, then move"
            f" the file away"
        ) from error
