"""A machine on which others work is not measured on, and the reason is one line."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from benchmarks import _console_recording, _quiet
from benchmarks._quiet import CoreTimes, core_times, expect_quiet, problem
from benchmarks.harness import Unavailable

STAT = "cpu  100 20 30 1000 50 4 6 10 7 3\ncpu0 1 1 1 1 1 1 1 1 1 1\n"
QUIET = CoreTimes(0, 0), CoreTimes(20, 380)


def test_the_cores_times_are_read_from_the_line_of_all() -> None:
    assert core_times(STAT) == CoreTimes(busy=100 + 20 + 30 + 4 + 6 + 10, idle=1050)


def test_a_quiet_machine_is_measured_on() -> None:
    assert problem(*QUIET, 0.4, 2) == ""
    assert problem(CoreTimes(5, 5), CoreTimes(5, 5), 0.0, 2) == ""


def test_what_others_use_is_said_in_one_line() -> None:
    found = problem(CoreTimes(1000, 1000), CoreTimes(1200, 1200), 0.4, 2)
    assert found == "other programs use 50% of this machine's 2 cores, at most 15%: end them first"


def test_a_load_that_has_just_ended_is_waited_for() -> None:
    found = problem(*QUIET, 1.51, 2)
    assert found == "the load average of the last minute is 1.51, at most 1.5: wait, and try again"
    assert problem(*QUIET, 1.5, 2) == ""


@pytest.mark.skipif(sys.platform != "linux", reason="the times of the cores are Linux's")
def test_a_machine_that_works_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """With as many programs as it has cores, whatever else runs on it."""
    monkeypatch.setattr(_quiet, "LOOK_S", 0.5)
    burning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        with pytest.raises(Unavailable, match=r"^nothing is measured or recorded: other programs use \d+% of"):
            expect_quiet()
    finally:
        for child in burning:
            child.kill()
            child.wait()


def test_nothing_is_recorded_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def busy() -> None:
        raise Unavailable("busy")

    def live_fleet(*_: object) -> None:
        pytest.fail("a fleet was started")

    monkeypatch.setattr(_console_recording, "expect_quiet", busy)
    monkeypatch.setattr(_console_recording, "live_fleet", live_fleet)
    with pytest.raises(Unavailable, match="busy"):
        _console_recording.recorded(file=_console_recording.FILE.with_name("none"))
