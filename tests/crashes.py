"""Whether a process of tests has crashed, which pytest-rerunfailures asks about before each test.

It asks over a socket, byte by byte, how often a process has crashed in this test: 1 ms of computing for each test, in
the process that gives tests out and in the one that runs it. Here a file says whether one has crashed at all.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, Final

import pytest

__all__ = ["ask_less"]

_INPUT: Final = "crash_note"


def ask_less(config: Any) -> None:
    """Have `make test` ask only when a process has crashed; pytest-rerunfailures is configured."""
    if (note := getattr(config, "workerinput", {}).get(_INPUT)) is not None:
        config.failures_db = NotedCrashes(config.failures_db, Path(note))
    elif config.getoption("dist", None) == "loadfile":
        config.pluginmanager.register(CrashNote())


class CrashNote:
    """In the process that gives tests out."""

    def __init__(self) -> None:
        self._file = tempfile.NamedTemporaryFile(prefix="ua-fleet-crashes-")  # noqa: SIM115 - it ends with the run

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """A process of tests is about to start."""
        node.workerinput[_INPUT] = self._file.name

    @pytest.hookimpl(optionalhook=True)
    def pytest_handlecrashitem(self) -> None:
        """One has crashed."""
        self._file.write(b"!")
        self._file.flush()

    def pytest_unconfigure(self) -> None:
        """The run is over."""
        self._file.close()


class NotedCrashes:
    """In a process of tests: in the place of what pytest-rerunfailures asks."""

    def __init__(self, asked: Any, note: Path) -> None:
        """What is asked where a crash is noted."""
        self._asked, self._note = asked, note

    def get_test_failures(self, nodeid: str) -> int:
        """How often a process has crashed in a test."""
        return int(self._asked.get_test_failures(nodeid)) if self._note.stat().st_size else 0

    def set_test_reruns(self, nodeid: str, reruns: int) -> None:
        """Nothing: no scheduler of ours gives out again what a process has crashed in."""
