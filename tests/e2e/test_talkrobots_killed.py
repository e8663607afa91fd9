"""Ten runs of the nine tasks that bridges carry, with the server killed in each; 100 with `tests.carried.killed`."""

from __future__ import annotations

import sys

import pytest

from tests.carried.killed import AS_IT_SHOULD_BE, FOR_GOOD
from tests.system import Processes

RUNS = 10


@pytest.mark.needs("ros1", "ros2", "ur")
@pytest.mark.timeout(900)
def test_nine_tasks_are_done_once_each_whenever_the_server_is_killed(processes: Processes) -> None:
    # In a process of its own: so the server that is started again, and all others, are forked.
    killing = processes.start(sys.executable, "-m", "tests.carried.killed", "--runs", str(RUNS), "--seed", "20")
    code = killing.process.wait(850)
    killing.end()
    told = [line for line in killing.lines if "killed after" in line]
    assert [line for line in told if not line.endswith(AS_IT_SHOULD_BE)] == []
    assert (code, len(told)) == (0, RUNS), "\n".join(killing.lines)
    assert sum(FOR_GOOD in line for line in told) == RUNS // 2
