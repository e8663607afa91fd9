"""What each file of tests computes: `make test ARGS=--computing`.

On a busy machine the time that a test takes says little; what it computes stays about the same. Of a file are counted
its process of tests, what that started and has ended, and what was forked off for it (`forking`).
"""

from __future__ import annotations

import resource
from collections import defaultdict
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, Final

import pytest

from tests import forking

__all__ = ["Computed", "ComputingMeter", "ComputingTable", "computed"]

_OUTPUT: Final = "computed_before_tests_s"


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
    return Computed(own.ru_utime + own.ru_stime, children.ru_utime + children.ru_stime + forking.computed_s())


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
