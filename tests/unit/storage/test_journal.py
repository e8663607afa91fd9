from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests import system
from ua_fleet.errors import StorageUnavailable
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome, Target
from ua_fleet.skill.journal import MemoryJournal, RecordedExecution, RecordedRequest, RequestorJournal, ResponderJournal
from ua_fleet.storage.journal import SqliteJournal
from ua_fleet.storage.server_records import ServerRecords

TARGET = Target(300, 2, 1500, 7)
RUNNING = ExecutionReport(ExecutionState.RUNNING)
DONE = ExecutionReport(ExecutionState.DONE, 0x4000_0000, "half of it: ½", b"\x0b\0\1")
ACCEPTED = RequestOutcome(OutcomeKind.ACCEPTED, DONE)


def id_of(number: int) -> bytes:
    return number.to_bytes(16, "big")


def request(number: int, outcome: RequestOutcome | None = None) -> RecordedRequest:
    return RecordedRequest(id_of(number), TARGET, b"\x06\x01\0\0\0", 133_000_000_000_000_000 + number, 2_000, outcome)


def execution(number: int, report: ExecutionReport = RUNNING) -> RecordedExecution:
    return RecordedExecution(id_of(number), "0.engine", 0, TARGET, b"", 133_000_000_000_000_000 - number, 0, report)


class Journals(NamedTuple):
    """Of a requestor and of a responder."""

    requests: RequestorJournal
    executions: ResponderJournal


@pytest.fixture(params=["memory", "server", "bridge"])
def journals(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Journals]:
    """All of them have to do the same."""
    if request.param == "memory":
        yield Journals(MemoryJournal(), MemoryJournal())
    elif request.param == "server":
        with ServerRecords(tmp_path) as records:
            yield Journals(records.requests, records.executions)
    else:
        with SqliteJournal(tmp_path / "journal.db") as opened:
            yield Journals(MemoryJournal(), opened)


def test_requests_are_remembered_with_their_outcomes(journals: Journals) -> None:
    journal = journals.requests
    for number in (1, 2, 3):
        journal.requested(request(number))
    journal.requested(request(4, ACCEPTED)._replace(version=7))
    journal.concluded(id_of(2), RequestOutcome(OutcomeKind.UNKNOWN, ExecutionReport(ExecutionState.UNKNOWN)))
    with journal.one_sync():
        journal.concluded(id_of(2), ACCEPTED)
        journal.settle()
        journal.withdrawn(id_of(3))
    withdrawn, last = request(3)._replace(timeout_ms=0), request(4, ACCEPTED)._replace(version=7)
    assert list(journal.requests()) == [request(1), request(2, ACCEPTED), withdrawn, last]
    journal.forget_requests([id_of(1), id_of(2)])
    journal.forget_requests([])
    assert list(journal.requests()) == [withdrawn, last]


def test_executions_are_remembered_in_the_order_in_which_they_were_recorded(journals: Journals) -> None:
    journal = journals.executions
    for number in (3, 1, 2):
        journal.recorded(execution(number))
    journal.reported(id_of(1), DONE)
    assert list(journal.executions()) == [execution(3), execution(1, DONE), execution(2)]
    journal.forget_executions([id_of(3)], {0: 55, 7: 66})
    journal.forget_executions([id_of(2)], {0: 77})
    journal.forget_executions([], {})
    journal.recorded(execution(3))
    assert list(journal.executions()) == [execution(1, DONE), execution(3)]
    assert journal.forgotten() == {0: 77, 7: 66}


def test_what_is_not_there_cannot_change(journals: Journals) -> None:
    with pytest.raises(KeyError):
        journals.requests.concluded(id_of(1), ACCEPTED)
    with pytest.raises(KeyError):
        journals.requests.withdrawn(id_of(1))
    with pytest.raises(KeyError):
        journals.executions.reported(id_of(1), DONE)


def test_all_of_it_is_there_when_the_file_is_opened_again(tmp_path: Path) -> None:
    with ServerRecords(tmp_path) as records:
        records.requests.requested(request(1, ACCEPTED))
        records.executions.recorded(execution(1, DONE))
        records.executions.forget_executions([], {0: 5})
    with ServerRecords(tmp_path) as records:
        assert list(records.requests.requests()) == [request(1, ACCEPTED)]
        [found] = records.executions.executions()
        assert found == execution(1, DONE)
        assert type(found.report.state) is ExecutionState
        assert records.executions.forgotten() == {0: 5}


def test_two_processes_cannot_share_a_journal(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    with SqliteJournal(path), pytest.raises(StorageUnavailable, match="in use by another process"):
        SqliteJournal(path)


def test_a_record_of_a_state_that_there_is_not_is_told(tmp_path: Path) -> None:
    path = tmp_path / "journal.db"
    with SqliteJournal(path) as journal:
        journal.recorded(execution(1))
    other = sqlite3.connect(path)
    other.execute("UPDATE executions SET state = 99")
    other.commit()
    other.close()
    with SqliteJournal(path) as journal, pytest.raises(StorageUnavailable, match="a record that is none"):
        journal.executions()


WRITER = """
import sys
from pathlib import Path
from tests.unit.storage.test_journal import DONE, execution, id_of, request
from ua_fleet.storage.server_records import ServerRecords

records = ServerRecords(Path(sys.argv[1]))
requests, executions = records.requests, records.executions
number = 0
while True:
    number += 1
    for name, record in (
        ("requested", lambda: requests.requested(request(number))),
        ("recorded", lambda: executions.recorded(execution(number))),
        ("reported", lambda: executions.reported(id_of(number), DONE)),
        ("forgotten", lambda: executions.forget_executions([id_of(number - 1)], {0: number - 1})),
    ):
        if name != "forgotten" or number > 1:
            record()
        print(name, number, flush=True)
"""


@pytest.mark.parametrize("said", [1, 2, 3, 4, 41, 42, 43, 44])
def test_what_had_returned_is_there_after_the_process_was_killed(tmp_path: Path, said: int) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)],
        cwd=system.ROOT,
        env=system.clean_environment(PYTHONPATH=f"{system.ROOT}:{system.ROOT / 'bridges'}"),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    lines = [child.stdout.readline() for _ in range(said)]
    os.kill(child.pid, signal.SIGKILL)
    lines += child.stdout.readlines()
    child.stdout.close()
    assert child.wait() == -signal.SIGKILL
    returned = [(name, int(number)) for name, number in (line.split() for line in lines if line.endswith("\n"))]
    last = dict(returned)
    with ServerRecords(tmp_path) as records:
        requests, journal = list(records.requests.requests()), records.executions
        executions, forgotten = list(journal.executions()), journal.forgotten()
    assert [found.execution_id for found in requests][: last["requested"]] == [
        id_of(number) for number in range(1, last["requested"] + 1)
    ]
    assert len(requests) - last["requested"] in (0, 1), "at most the one that was being written"
    newest = len(requests)
    newest_recorded = int.from_bytes(executions[-1].execution_id, "big") if executions else 0
    assert newest_recorded >= last.get("recorded", 0)
    assert newest_recorded <= newest
    ended = {int.from_bytes(found.execution_id, "big") for found in executions if found.report == DONE}
    gone = forgotten.get(0, 0)
    assert gone >= last.get("forgotten", 1) - 1
    assert all(number in ended or number <= gone for number in range(1, last.get("reported", 0) + 1))
    assert all(int.from_bytes(found.execution_id, "big") > gone for found in executions), "both or nothing"
