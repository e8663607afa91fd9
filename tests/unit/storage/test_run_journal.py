"""The journal of runs: what was written is there again, also after kill -9."""

from __future__ import annotations

import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from ua_fleet.errors import StorageUnavailable
from ua_fleet.orchestrator import Fault, Halt, HaltChanged
from ua_fleet.scenario.facts import Fact, RunCreated, RunEnded, RunOutcome, StepStarted
from ua_fleet.storage.run_journal import RunJournal, StoredRun

WRITER = """
import os, signal, sys
from pathlib import Path
from ua_fleet.scenario.facts import StepStarted
from ua_fleet.storage.run_journal import RunJournal

journal = RunJournal(Path(sys.argv[1]))
for number in range(1000):
    journal.write([("r1", StepStarted(float(number), "a")), ("r1", StepStarted(float(number), "b"))])
    print(number, flush=True)
    if number == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
"""


def created(run_id: str) -> Fact:
    return RunCreated(1.0, run_id, "version: 1", {"speed": 0.5}, "anna")


def test_facts_come_back_in_their_order(tmp_path: Path) -> None:
    facts = [created("r1"), StepStarted(2.0, "0"), RunEnded(3.0, RunOutcome.DONE)]
    with RunJournal(tmp_path / "runs.db") as journal:
        journal.write([("r1", facts[0]), ("r2", created("r2"))])
        journal.write([("r1", fact) for fact in facts[1:]])
    with RunJournal(tmp_path / "runs.db") as journal:
        assert journal.facts("r1") == facts
        assert journal.facts("r2") == [created("r2")]
        assert journal.facts("r3") == []
        assert journal.runs() == [StoredRun("r1", True), StoredRun("r2", False)]


def test_only_the_oldest_runs_that_have_ended_are_forgotten(tmp_path: Path) -> None:
    with RunJournal(tmp_path / "runs.db") as journal:
        for number in range(5):
            journal.write([(f"r{number}", created(f"r{number}"))])
            if number != 1:
                journal.write([(f"r{number}", RunEnded(9.0, RunOutcome.DONE))])
        assert journal.prune(2) == ["r0", "r2"]
        assert [run.run_id for run in journal.runs()] == ["r1", "r3", "r4"]
        assert journal.facts("r0") == []
        assert journal.prune(2) == []


def test_faults_are_kept_until_they_are_over_and_seen(tmp_path: Path) -> None:
    active = Fault("ur3.skill", "ur3", "skill", "grab failed", True, False, 5.0)
    seen = Fault("ur3.skill", "ur3", "skill", "grab failed", True, True, 5.0, "anna")
    over = Fault("ur3.skill", "ur3", "skill", "grab failed", False, True, 5.0, "anna")
    with RunJournal(tmp_path / "runs.db") as journal:
        journal.write([], [active])
        assert journal.faults() == [active]
        journal.write([], [seen])
        assert journal.faults() == [seen]
        journal.write([], [over])
        assert journal.faults() == []


def test_halts_are_kept_until_they_are_confirmed(tmp_path: Path) -> None:
    first, second = Halt("aa" * 16, "ned", "go", 1.0), Halt("bb" * 16, "ted", "go", 2.0)
    with RunJournal(tmp_path / "runs.db") as journal:
        journal.write([], (), [HaltChanged(second, is_owed=True), HaltChanged(first, is_owed=True)])
    with RunJournal(tmp_path / "runs.db") as journal:
        assert journal.halts() == [first, second]
        journal.write([], (), [HaltChanged(first, is_owed=False)])
        assert journal.halts() == [second]


@pytest.mark.parametrize("at", [0, 7])
def test_what_was_written_survives_a_kill(tmp_path: Path, at: int) -> None:
    path = tmp_path / "runs.db"
    ended = subprocess.run([sys.executable, "-c", WRITER, path, str(at)], capture_output=True, text=True, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    said = len(ended.stdout.splitlines())
    with RunJournal(path) as journal:
        facts = journal.facts("r1")
    assert said == at + 1
    assert [(fact.at, fact.step) for fact in facts if isinstance(fact, StepStarted)] == [
        (float(number), step) for number in range(said) for step in "ab"
    ]


def test_a_fact_that_is_none_is_said_with_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "runs.db"
    with RunJournal(path) as journal:
        journal.write([("r1", created("r1"))])
    connection = sqlite3.connect(path)
    connection.execute("""UPDATE facts SET line = '{"fact": "Other"}'""")
    connection.commit()
    connection.close()
    with RunJournal(path) as journal, pytest.raises(StorageUnavailable, match="fact of run r1 that is none"):
        journal.facts("r1")


def test_a_second_process_is_refused(tmp_path: Path) -> None:
    with RunJournal(tmp_path / "runs.db"), pytest.raises(StorageUnavailable, match="in use"):
        RunJournal(tmp_path / "runs.db")
