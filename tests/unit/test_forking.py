"""Processes that the tests fork off are as those that they start."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from tests.system import Processes, clean_environment

PROGRAM = """
import os, sys, time
print("hello", __name__, sys.argv[1:], os.environ.get("OF_THE_TEST"), sorted(os.listdir("/proc/self/fd")), flush=True)
print("to stderr", os.getpgid(0) == os.getpid(), file=sys.stderr)
if sys.argv[1:] == ["waits"]:
    time.sleep(60)
raise SystemExit(3 if sys.argv[1:] == ["fails"] else None)
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return path


def test_it_runs_the_program_with_its_arguments_and_environment(program: Path, processes: Processes) -> None:
    child = processes.fork(program, "one", "two", env=clean_environment(OF_THE_TEST="yes"))
    assert child.process.wait(20) == 0
    child.end()
    assert child.lines[0].startswith("hello __main__ ['one', 'two'] yes ['0', '1', '2'")
    assert child.lines[1:] == ["to stderr True"]
    assert processes.fork(program, "fails").process.wait(20) == 3
    assert "None" in processes.fork(program).wait_for("hello")


def test_it_is_killed_and_its_id_belongs_to_it_until_that_is_known(program: Path, processes: Processes) -> None:
    child = processes.fork(program, "waits")
    child.wait_for("hello")
    assert child.process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        child.process.wait(0.05)
    os.kill(child.process.pid, signal.SIGKILL)
    while Path(f"/proc/{child.process.pid}/stat").read_text().split()[2] != "Z":
        time.sleep(0.01)
    os.killpg(child.process.pid, signal.SIGCONT)  # nobody else
    assert child.end(signal.SIGKILL) == -signal.SIGKILL
    while Path(f"/proc/{child.process.pid}").exists():
        time.sleep(0.01)
