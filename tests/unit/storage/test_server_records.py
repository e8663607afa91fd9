"""One file of a server: what it takes over from the four before, killed anywhere, and what it refuses."""

from __future__ import annotations

import shutil
import sqlite3
import stat
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.kill_points import kill_points
from ua_fleet.errors import UPGRADE, StorageUnavailable
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, Target
from ua_fleet.skill.journal import RecordedRequest
from ua_fleet.storage.database import version_of
from ua_fleet.storage.journal import SqliteJournal
from ua_fleet.storage.registry import Registry
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.storage.server_records import OLD_FILES, SERVER_FILE, ServerRecords

DUMPS = Path(__file__).parent / "old_files"
"""What a server of before `server.db` has written, as SQL."""
Opened = SqliteJournal | RunJournal | Registry
OPENED: dict[str, Callable[[Path], Opened]] = {
    "robots.db": Registry,
    "commands.db": SqliteJournal,
    "offers.db": SqliteJournal,
    "runs.db": RunJournal,
}
"""How a server of before opened them."""
TARGET = Target(300, 2, 1500, 7)
UNKNOWN = RequestOutcome(OutcomeKind.UNKNOWN, ExecutionReport(ExecutionState.UNKNOWN, 0x8031_0000, "no answer came"))


def id_of(number: int) -> bytes:
    return number.to_bytes(16, "big")


def request(number: int, timeout_ms: int, outcome: RequestOutcome | None, version: int) -> RecordedRequest:
    issued = 133_000_000_000_000_000 + number
    return RecordedRequest(id_of(number), TARGET, b"\x06\x01\0\0\0", issued, timeout_ms, outcome, version)


REQUESTS = [request(2, 2000, UNKNOWN, 3), request(3, 2000, None, 3), request(4, 0, None, 0)]


def old_file(folder: Path, name: str) -> None:
    with closing(sqlite3.connect(folder / name)) as connection:
        connection.executescript((DUMPS / name).with_suffix(".sql").read_text(encoding="utf-8"))


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """The folder of a server of before."""
    folder = tmp_path / "state"
    folder.mkdir()
    for name in OLD_FILES:
        old_file(folder, name)
    return folder


def told_by(robots: Registry, executions: SqliteJournal, runs: RunJournal) -> dict[str, Any]:
    """All that these say."""
    facts = {run.run_id: runs.facts(run.run_id) for run in runs.runs()}
    settings, forgotten = runs.settings(), executions.forgotten()
    kept = [runs.runs(), facts, runs.faults(), runs.halts(), runs.holds(), settings]
    return {"robots": robots.robots(), "executions": [*executions.executions()], "forgotten": forgotten, "runs": kept}


def told_before(folder: Path) -> dict[str, Any]:
    with (
        Registry(folder / "robots.db") as robots,
        SqliteJournal(folder / "offers.db") as executions,
        RunJournal(folder / "runs.db") as runs,
    ):
        return told_by(robots, executions, runs)


def told(records: ServerRecords) -> dict[str, Any]:
    return told_by(records.robots, records.executions, records.runs)


def versions(folder: Path) -> set[int]:
    return {version_of(folder / name) for name in OLD_FILES}


def test_what_the_old_files_have_is_taken_over(old: Path) -> None:
    before = told_before(old)
    assert [len(part) for part in before.values()] == [2, 2, 1, 6]
    assert [len(part) for part in before["runs"]] == [2, 2, 2, 1, 1, 2]
    for _ in range(2):
        with ServerRecords(old) as records:
            assert told(records) == before
            assert list(records.requests.requests()) == REQUESTS
        assert versions(old) == {2}
    assert sorted(path.name for path in old.iterdir()) == sorted([*OLD_FILES, SERVER_FILE])


def test_it_goes_on_where_the_old_files_end(old: Path) -> None:
    with ServerRecords(old) as records:
        records.requests.concluded(id_of(3), UNKNOWN)
        records.requests.requested(request(5, 10, None, 1))
        records.requests.forget_requests([id_of(2)])
        assert list(records.requests.requests()) == [
            request(3, 2000, UNKNOWN, 3),
            request(4, 0, None, 0),
            request(5, 10, None, 1),
        ]
        assert records.runs.prune(0) == ["r2"]
        assert [run.run_id for run in records.runs.runs()] == ["r1"]


@pytest.mark.parametrize("name", OLD_FILES)
def test_each_of_them_alone_is_taken_over(old: Path, name: str) -> None:
    before = told_before(old)
    for other in OLD_FILES:
        if other != name:
            (old / other).unlink()
    with ServerRecords(old) as records:
        found = told(records) | {"requests": list(records.requests.requests())}
    part = {"commands.db": "requests", "offers.db": "executions"}.get(name, name.removesuffix(".db"))
    assert found[part] == (before | {"requests": REQUESTS})[part]
    for key, other in found.items():
        if key != part and (key, part) != ("forgotten", "executions"):
            assert not any(other), key


def test_files_from_before_their_later_tables_are_taken_over(old: Path) -> None:
    for name, tables in {
        "commands.db": ["request_versions"],
        "runs.db": ["settings", "fault_capacities", "halts", "halt_reasons", "holds"],
    }.items():
        with closing(sqlite3.connect(old / name)) as connection:
            for table in tables:
                connection.execute(f"DROP TABLE {table}")
    with ServerRecords(old) as records:
        assert [found.version for found in records.requests.requests()] == [0, 0, 0]
        assert [len(part) for part in told(records)["runs"]] == [2, 2, 2, 0, 0, 0]


def test_a_kill_within_the_takeover_loses_and_doubles_nothing(old: Path, tmp_path: Path) -> None:
    before = told_before(old)
    with kill_points(old, tmp_path) as points:
        ServerRecords(old).close()
    seen: set[int] = set()
    for point, _ in points.made:
        seen |= versions(point)
        with ServerRecords(point) as records:
            assert told(records) == before, point
            assert list(records.requests.requests()) == REQUESTS, point
        assert versions(point) == {2}
        ServerRecords(point).close()
    assert len(points.made) > 10
    assert seen == {1, 2}


def test_a_full_disk_within_the_takeover_leaves_all_as_it_was(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            if sql == "COMMIT" and self.total_changes > 5:
                error = sqlite3.OperationalError("database or disk is full")
                error.sqlite_errorcode = sqlite3.SQLITE_FULL
                raise error
            return super().execute(sql, *values)

    before = told_before(old)
    with monkeypatch.context() as patch:
        patch.setattr(sqlite3, "connect", partial(sqlite3.connect, factory=Full))
        with pytest.raises(StorageUnavailable, match=r"server\.db: the disk is full; free some space"):
            ServerRecords(old)
    assert versions(old) == {1}
    assert told_before(old) == before, "an earlier ua-fleet could go on with them"
    with ServerRecords(old) as records:
        assert told(records) == before


@pytest.mark.parametrize("name", OLD_FILES)
def test_an_old_file_that_cannot_be_used_stops_the_start_until_it_is_away(old: Path, name: str) -> None:
    (old / name).write_bytes(b"no database at all " * 100)
    for _ in range(2):
        with pytest.raises(StorageUnavailable, match=rf"{name} is broken .* move the file away"):
            ServerRecords(old)
    (old / name).unlink()
    with ServerRecords(old) as records:
        assert list(records.requests.requests()) == ([] if name == "commands.db" else REQUESTS)


def test_an_old_file_of_another_program_is_left_alone(old: Path) -> None:
    (old / "runs.db").unlink()
    with closing(sqlite3.connect(old / "runs.db")) as connection:
        connection.execute("CREATE TABLE theirs (name)")
    before = (old / "runs.db").read_bytes()
    with pytest.raises(StorageUnavailable, match=r"runs\.db is another program's file"):
        ServerRecords(old)
    assert (old / "runs.db").read_bytes() == before


def test_an_old_server_that_still_runs_is_told(old: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.storage.database._LOCK_WAIT_S", 0.0)
    with RunJournal(old / "runs.db"), pytest.raises(StorageUnavailable, match=r"runs\.db is in use by another process"):
        ServerRecords(old)
    with ServerRecords(old) as records:
        assert list(records.requests.requests()) == REQUESTS


@pytest.mark.parametrize("name", OLD_FILES)
def test_an_earlier_ua_fleet_refuses_what_was_taken_over(old: Path, name: str) -> None:
    ServerRecords(old).close()
    with pytest.raises(StorageUnavailable) as caught:
        OPENED[name](old / name)
    assert str(caught.value) == f"{old / name} has version 2, and this ua-fleet reads version 1; {UPGRADE}"


@pytest.mark.parametrize("name", OLD_FILES)
def test_an_old_file_that_comes_later_is_not_passed_over(old: Path, name: str) -> None:
    kept = old.with_name("kept")
    shutil.copytree(old, kept)
    with ServerRecords(old) as records:
        before = told(records)
    shutil.copy(kept / name, old / name)
    with pytest.raises(StorageUnavailable, match=rf"{name} is of an earlier ua-fleet, .*server\.db .*; move one of"):
        ServerRecords(old)
    (old / name).unlink()
    with ServerRecords(old) as records:
        assert told(records) == before


@pytest.mark.parametrize("content", [b"", b"no database at all " * 100])
def test_what_became_of_an_old_file_later_is_nobody_s_concern(old: Path, content: bytes) -> None:
    with ServerRecords(old) as records:
        before = told(records)
    (old / "runs.db").write_bytes(content)
    with ServerRecords(old) as records:
        assert told(records) == before


def test_old_files_that_were_taken_over_are_not_taken_over_again(old: Path) -> None:
    ServerRecords(old).close()
    (old / SERVER_FILE).unlink()
    with ServerRecords(old) as records:
        assert list(records.requests.requests()) == []
        assert records.runs.runs() == []


def test_only_the_owner_can_read_it(old: Path) -> None:
    with ServerRecords(old) as records:
        records.requests.requested(request(9, 10, None, 0))
        files = [path for path in old.iterdir() if path.name.startswith(SERVER_FILE)]
        assert {path.name for path in files} == {SERVER_FILE, f"{SERVER_FILE}-wal"}
        assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}


def test_two_servers_cannot_share_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ua_fleet.storage.database._LOCK_WAIT_S", 0.0)
    with ServerRecords(tmp_path), pytest.raises(StorageUnavailable, match=r"server\.db is in use by another process"):
        ServerRecords(tmp_path)


def test_a_broken_one_is_told_with_the_remedy(tmp_path: Path) -> None:
    (tmp_path / SERVER_FILE).write_bytes(b"no database at all " * 100)
    with pytest.raises(StorageUnavailable, match=r"server\.db is broken .*; see what the robots are doing, then move"):
        ServerRecords(tmp_path)
