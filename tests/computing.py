"""What each file of tests computes: `make test ARGS=--computing`.

On a busy machine the time that a test takes says little; what it computes stays about the same. Of a file are counted
its process of tests, what that started and has ended, and what was forked off for it (`forking`). A browser ends
without waiting for its helpers, which compute most of it: who ends one notes them before (`note_browsers`).
"""

from __future__ import annotations

import contextlib
import os
import resource
from collections import defaultdict
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pytest

from tests import forking

__all__ = ["Computed", "ComputingMeter", "ComputingTable", "computed", "note_browsers"]

_OUTPUT: Final = "computed_before_tests_s"
_HELPER: Final = b"--type="
"""What stands in the command of each of Chromium's processes but the first."""
_TICKS_A_SECOND: Final = os.sysconf("SC_CLK_TCK")
_helpers_s: Final[dict[tuple[int, str], float]] = {}
"""Of each browser, by its id and its begin; a helper of it that has ended is in what another one has waited for."""
_running_s: Final[list[float]] = []
"""Of browsers and what drives them while they run; once they have ended they are children like others."""


@dataclass(frozen=True)
class Computed:
    """Seconds of all cores, of a user's and the system's."""

    own_s: float = 0.0
    """Of a process of tests."""
    children_s: float = 0.0
    """Of those that it had, and that it has waited for."""

    def __add__(self, other: Computed) -> Computed:
        return Computed(self.own_s + other.own_s, self.children_s + other.children_s)

    def __sub__(self, other: Computed) -> Computed:
        return Computed(self.own_s - other.own_s, self.children_s - other.children_s)

    @property
    def all_s(self) -> float:
        """Of both."""
        return self.own_s + self.children_s


def computed() -> Computed:
    """What this process has computed up to now, and its children that have ended."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return Computed(
        own.ru_utime + own.ru_stime,
        children.ru_utime + children.ru_stime + forking.computed_s() + sum(_helpers_s.values()) + sum(_running_s),
    )


def note_browsers() -> None:
    """Count what the browsers of this process have computed up to now, and before they end what their helpers have.

    Nobody waits for helpers, so no system call tells it later.
    """
    parents: dict[int, int] = {}
    seconds: dict[int, float] = {}
    begins: dict[int, str] = {}
    helpers: set[int] = set()
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            # After the name: state, parent; utime, stime, cutime, cstime are the 12th to the 15th, the 20th its begin.
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
            pid = int(folder.name)
            parents[pid], begins[pid] = int(fields[1]), fields[19]
            seconds[pid] = sum(int(ticks) for ticks in fields[11:15]) / _TICKS_A_SECOND
            if _HELPER in (folder / "cmdline").read_bytes():
                helpers.add(pid)
    running: set[int] = set()
    helpers_s: dict[tuple[int, str], float] = defaultdict(float)
    for helper in helpers:
        above = [helper]
        while (parent := parents.get(above[-1], 0)) > 1 and parent != os.getpid():
            above.append(parent)
        others = [pid for pid in above if pid not in helpers]
        if parent == os.getpid() and others:
            helpers_s[others[0], begins[others[0]]] += seconds[helper]
            running.update(others)
    _running_s[:] = [seconds[pid] for pid in running]
    for browser, noted in helpers_s.items():
        _helpers_s[browser] = max(noted, _helpers_s.get(browser, 0.0))


class ComputingMeter:
    """In each process that runs tests: writes into each report what was computed since the one before."""

    def __init__(self) -> None:
        self._before = Computed()
        self._before_tests = Computed()

    def pytest_runtestloop(self) -> None:
        """All tests are collected."""
        self._before = self._before_tests = computed()

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_makereport(self) -> Generator[None, Any]:
        """A part of a test is done."""
        outcome = yield
        now = computed()
        since, self._before = now - self._before, now
        outcome.get_result().computed = since.own_s, since.children_s

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Tell what it took to collect."""
        if (output := getattr(session.config, "workeroutput", None)) is not None:
            output[_OUTPUT] = self._before_tests.all_s


class ComputingTable:
    """In the process that tells of the tests: adds up by files."""

    def __init__(self) -> None:
        self._files: dict[str, Computed] = defaultdict(Computed)
        self._tests: dict[str, int] = defaultdict(int)
        self._before_tests_s: list[float] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A part of a test is done."""
        file = report.nodeid.split("::", 1)[0]
        self._files[file] += Computed(*getattr(report, "computed", ()))
        self._tests[file] += report.when == "call"

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """A process of tests has ended."""
        self._before_tests_s.append(getattr(node, "workeroutput", {}).get(_OUTPUT, 0.0))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Show the files, those first that compute most."""
        terminalreporter.section("seconds that files of tests computed")
        terminalreporter.write_line("    all  tests' process  its children  tests  file")
        files = sorted(self._files.items(), key=lambda file: -file[1].all_s)
        rows = [(took, self._tests[file], file) for file, took in files]
        rows.append((sum(self._files.values(), Computed()), sum(self._tests.values()), "in all"))
        for took, tests, file in rows:
            terminalreporter.write_line(
                f"{took.all_s:7.2f}  {took.own_s:14.2f}  {took.children_s:12.2f}  {tests:5}  {file}"
            )
        if self._before_tests_s:
            each = ", ".join(f"{seconds:.1f}" for seconds in self._before_tests_s)
            terminalreporter.write_line(f"before its first test each process computed {each} s")
