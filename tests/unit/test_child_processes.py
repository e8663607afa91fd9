"""A program that does not end in order fails the test that started it, and is told of."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.system import Processes

STUBBORN = """
import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
def hang():
    print("ready", flush=True)
    time.sleep(60)
hang()
"""
OBEDIENT = STUBBORN.replace("SIG_IGN", "SIG_DFL")


def stubborn(folder: Path) -> Path:
    path = folder / "stubborn.py"
    path.write_text(STUBBORN)
    return path


def test_a_process_that_has_to_be_killed_fails_the_test_and_says_where_it_stands(
    tmp_path: Path, processes: Processes
) -> None:
    child = processes.fork(stubborn(tmp_path), "an argument")
    child.wait_for("ready")
    with pytest.raises(AssertionError) as told:
        child.end(timeout_s=0.2)
    said = str(told.value)
    assert f"{tmp_path / 'stubborn.py'} an argument did not end by SIGTERM within 0.2 s, and was killed" in said
    assert "    ready\n" in said
    assert "in hang\n" in said
    assert child.end() < 0  # it is told once


def test_one_that_is_not_forked_is_killed_too(tmp_path: Path, processes: Processes) -> None:
    child = processes.start("sh", "-c", "trap '' TERM ABRT; echo ready; while :; do sleep 0.1; done")
    child.wait_for("ready")
    with pytest.raises(AssertionError, match=r"trap .* did not end by SIGTERM within 0\.2 s"):
        child.end(timeout_s=0.2)
    assert child.process.poll() == -signal.SIGKILL


def test_all_are_ended_whichever_does_not_end_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    obedient = tmp_path / "obedient.py"
    obedient.write_text(OBEDIENT)
    monkeypatch.setattr(Processes, "patience_s", 0.2)
    started = Processes()
    with pytest.raises(AssertionError, match=r"stubborn\.py"), started as processes:  # noqa: PT012
        for program in (obedient, stubborn(tmp_path)):
            processes.fork(program).wait_for("ready")
    assert all(child.process.poll() is not None for child in started.children)
    with pytest.raises(RuntimeError, match="of the test") as failed, Processes() as processes:  # noqa: PT012
        processes.fork(stubborn(tmp_path)).wait_for("ready")
        raise RuntimeError("of the test itself")
    assert ["did not end by SIGTERM" in note for note in failed.value.__notes__] == [True]
