"""What a server records, in one SQLite file: registered robots, requests, executions by clients, runs and faults.

    robots.db, commands.db, offers.db, runs.db --once--> server.db

Servers had these four files before. What stands in them is copied by the commit that makes `server.db`; then each of
them is marked as taken over, and left where it is:

    killed                       the next start finds                      and does
    before the commit            no table in server.db                     all of it from the beginning
    before the marks             taken_over: not marked, file: version 1   marks the file
    between a mark and its note  taken_over: not marked, file: version 2   notes it
    after that                   taken_over: marked                        nothing

A mark is the next version of the file, so that an earlier ua-fleet, which does not know `server.db`, refuses to start
from what is out of date. A file without a mark beside a `server.db` that has not taken it over was put there by
somebody, and the server refuses to pass over it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Final, NamedTuple, Self

from ua_fleet.errors import StorageUnavailable
from ua_fleet.storage.alarm_states import ALARM_TABLES, AlarmStates
from ua_fleet.storage.database import Database, Run, version_of
from ua_fleet.storage.journal import EXECUTION_COLUMNS, EXECUTION_TABLES, SqliteJournal
from ua_fleet.storage.registry import REGISTRY_TABLES, Registry
from ua_fleet.storage.request_journal import REQUEST_COLUMNS, REQUEST_TABLES, RequestJournal
from ua_fleet.storage.run_journal import RUN_TABLES, RunJournal

__all__ = ["OLD_FILES", "SERVER_FILE", "ServerRecords"]

SERVER_FILE: Final = "server.db"
"""In the server's `state_dir`."""
_VERSION: Final = 1
_TAKEN_OVER: Final = """CREATE TABLE taken_over (name TEXT PRIMARY KEY, is_marked INTEGER NOT NULL) STRICT"""
"""The old files that are in this one, and whether they are marked."""
_OLD_VERSION: Final = 1
_MARKED_VERSION: Final = 2


class _Copied(NamedTuple):
    """What a table gets of an old file."""

    table: str
    columns: str
    selected: str = ""
    """The same of the old file, where it has them otherwise."""
    joined: str = ""
    """A table that the old file has them in, too."""


class _Old(NamedTuple):
    opened: type[SqliteJournal | RunJournal | Registry]
    """Opens such a file, completes it, and sees whether it can be read."""
    tables: Sequence[_Copied]


OLD_FILES: Final = {
    "robots.db": _Old(Registry, [_Copied("robots", "name, origin, bridge, definition, registered_by, registered_s")]),
    "commands.db": _Old(
        SqliteJournal,
        [
            _Copied(
                "requests",
                f"number, {REQUEST_COLUMNS}",
                f"number, {REQUEST_COLUMNS.replace('version', 'coalesce(version, 0)')}",
                "LEFT JOIN request_versions USING (execution_id)",
            )
        ],
    ),
    "offers.db": _Old(
        SqliteJournal,
        [_Copied("executions", f"number, {EXECUTION_COLUMNS}"), _Copied("forgotten", "space, issued")],
    ),
    "runs.db": _Old(
        RunJournal,
        [
            _Copied("runs", "number, run_id, ended"),
            _Copied("facts", "number, run_id, line"),
            _Copied("faults", "robot, source, reason, active, acknowledged, since, acknowledged_by"),
            _Copied("fault_capacities", "robot, source, capacities"),
            _Copied("settings", "name, value, instead_of, set_by, set_at"),
            _Copied("halts", "execution_id, robot, skill, since"),
            _Copied("halt_reasons", "execution_id, why"),
            _Copied("holds", "robot, held_by, since, reason"),
        ],
    ),
}
"""The files that servers had before this one."""


class ServerRecords:
    """The file of one server, and its parts: what they write together is one commit."""

    def __init__(self, state_dir: Path) -> None:
        """Open it, or begin one with what the old files have; no other process can use it until `close`.

        Args:
            state_dir: of the server.

        Raises:
            StorageUnavailable: it, or an old file, cannot be used. Nothing is lost: the next start tries again.
        """
        self._database = Database(
            state_dir / SERVER_FILE,
            version=_VERSION,
            schema=(*REGISTRY_TABLES, *REQUEST_TABLES, *EXECUTION_TABLES, *RUN_TABLES, _TAKEN_OVER),
            additions=ALARM_TABLES,
            fill=lambda run: _take_over(state_dir, run),
            is_prompt=True,
        )
        try:
            self._mark_old_files(state_dir)
        except BaseException:
            self._database.close()
            raise
        self.robots = Registry(self._database)
        """Those that were registered or announced."""
        self.requests = RequestJournal(self._database)
        """What robots behind bridges were asked to do."""
        self.executions = SqliteJournal(self._database)
        """What clients were asked to do."""
        self.runs = RunJournal(self._database)
        """Runs of scenarios, faults, halts, holds and settings."""

        self.alarms = AlarmStates(self._database)
        """How alarms are."""

    def close(self) -> None:
        """Give the file free. Safe to call twice."""
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _mark_old_files(self, state_dir: Path) -> None:
        noted = dict(self._database.read("SELECT name, is_marked FROM taken_over"))
        for name in OLD_FILES:
            path = state_dir / name
            if noted.get(name) == 0:
                if version_of(path) == _OLD_VERSION:
                    with closing(Database(path, version=_OLD_VERSION, schema=())) as old:
                        old.commit((f"PRAGMA user_version={_MARKED_VERSION}", ()))
                self._database.commit(("UPDATE taken_over SET is_marked = 1 WHERE name = ?", (name,)))
            elif _is_unmarked(path):
                raise StorageUnavailable(
                    f"{path} is of an earlier ua-fleet, and {self._database.path} has taken the place of such files;"
                    f" move one of the two away"
                )


def _take_over(state_dir: Path, run: Run) -> None:
    """Copy what the old files have that were not taken over before."""
    for name, old in OLD_FILES.items():
        path = state_dir / name
        if version_of(path) == _MARKED_VERSION or not path.exists():
            continue
        old.opened(path).close()
        with closing(Database(path, version=_OLD_VERSION, schema=())) as database:
            for copied in old.tables:
                places = ", ".join("?" * len(copied.columns.split(",")))
                insert = f"INSERT INTO {copied.table} ({copied.columns}) VALUES ({places})"  # noqa: S608 - constants, here and below
                select = f"SELECT {copied.selected or copied.columns} FROM {copied.table} {copied.joined}"  # noqa: S608
                for row in database.rows(select):
                    run(insert, row)
        run("INSERT INTO taken_over VALUES (?, 0)", (name,))


def _is_unmarked(path: Path) -> bool:
    with suppress(StorageUnavailable):  # what cannot be read is of no use here, and in nobody's way
        return version_of(path) == _OLD_VERSION
    return False
