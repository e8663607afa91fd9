"""Processes of tests that are forked off one that has imported these are as xdist's own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests import system

CONFTEST = """
from tests.forked_workers import ForkedWorkers
def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(ForkedWorkers())
"""
SHARED = """
import os
with open("imports.txt", "a") as imports:
    print(os.getpid(), file=imports)
"""
TESTS = """
import os
import shared
from tests import system
def test_it_runs(tmp_path):
    with open("runs.txt", "a") as runs:
        print(os.getpid(), system.free_tcp_port(), os.environ["OF_THE_RUN"], os.environ["PYTEST_XDIST_WORKER"],
            tmp_path, os.getpgid(0), os.read(0, 1) == b"", file=runs)
def test_it_fails():
    first, second = 1, 2
    print("said before")
    assert first == second
"""


def run(folder: Path, **files: str) -> str:
    """What pytest says of these files, run by two processes."""
    for name, text in {"conftest": CONFTEST, "shared": SHARED, **files}.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-n",
            "2",
            "--dist",
            "loadfile",
            "-p",
            "no:cacheprovider",
            "-p",
            "no:asyncio",
            "-raEf",
            ".",
        ],
        cwd=folder,
        env=system.clean_environment(OF_THE_RUN="this", PYTHONPATH=str(system.ROOT)),
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout + done.stderr


def test_tests_are_imported_once_and_run_by_processes_of_their_own(tmp_path: Path) -> None:
    said = run(tmp_path, test_a=TESTS, test_b=TESTS)
    assert "2 failed, 2 passed" in said
    assert "assert 1 == 2" in said, "assertions are rewritten"
    assert said.count("Captured stdout call") == 2, "output is captured for each process"
    assert len((tmp_path / "imports.txt").read_text().split()) == 1
    one, other = (line.split() for line in (tmp_path / "runs.txt").read_text().splitlines())
    for what, mine, its in zip(("process", "port"), one, other, strict=False):
        assert mine != its, what
    assert one[2] == other[2] == "this"
    assert {one[3], other[3]} == {"gw0", "gw1"}
    assert one[4] != other[4], "each has its own folder"
    assert one[5] == other[5], "a signal for the group is for both"
    assert one[6] == other[6] == "True"


def test_one_that_dies_is_replaced(tmp_path: Path) -> None:
    said = run(tmp_path, test_a="import os\ndef test_it_dies():\n    os._exit(3)\n", test_b=TESTS)
    # xdist gives the test that a process died of to those that replace it too, a few times.
    assert "worker 'gw2' crashed while running 'test_a.py::test_it_dies'" in said
    assert "1 passed" in said


def test_what_cannot_be_imported_is_told_as_ever(tmp_path: Path) -> None:
    skips = "import pytest\npytest.skip('not here', allow_module_level=True)\n"
    said = run(tmp_path, test_a="import nowhere_at_all\n", test_b=skips)
    assert "No module named 'nowhere_at_all'" in said
    assert "1 skipped, 1 error" in said
