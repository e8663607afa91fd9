"""Ten runs of the nine tasks that bridges carry, with the server killed in each; 100 with `tests.carried.killed`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest
from ua_demo.talkrobots.setting import DOMAINS

from tests.carried.killed import Judged, runs_with_kills
from tests.system import ros_domain

RUNS = 10


@pytest.mark.needs("ros1", "ros2", "ur")
@pytest.mark.timeout(900)
async def test_nine_tasks_are_done_once_each_whenever_the_server_is_killed(tmp_path: Path) -> None:
    runs: list[Judged] = []
    with ExitStack() as held:
        domains = [held.enter_context(ros_domain()) for _ in range(DOMAINS)]
        async for judged in runs_with_kills(tmp_path, domains, RUNS, seed=20):
            assert not judged.problems, judged
            runs.append(judged)
    assert len(runs) == RUNS
    assert sum(run.is_for_good for run in runs) == RUNS // 2
