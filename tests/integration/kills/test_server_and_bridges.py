"""Real kills at random moments of scenarios: what robots were told is what the server has written down."""

from __future__ import annotations

import asyncio
from collections import Counter

import pytest

from tests.integration.kills.conftest import SECURED, SERVER, crew_of, stop
from tests.integration.kills.ledger import facts_of, keep
from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, run, run_is, value
from tests.integration.scenarios.machines import FAILS_EVERY_OTHER_TIME
from ua_fleet.scenario.facts import RunEnded, TaskAssigned, TaskOutcome, TaskOver
from ua_fleet.server.app import RUN_JOURNAL

STEPS = """
  - {task: begin, skill: work, robot: left, arguments: {work: begin, seconds: 0.2}, retries: 3}
  - parallel:
      - - repeat:
            - {task: on_left, skill: work, robot: left, arguments: {work: left, seconds: 0.3}, retries: 3}
            - {task: any, skill: work, capacity: weld, arguments: {work: any, seconds: 0.2}, retries: 3}
          while: left.go_on > 0
      - - repeat:
            - {task: odd, skill: work, robot: middle, arguments: {work: =odd, seconds: 0.3}, retries: 3}
          while: left.go_on > 0
      - - repeat:
            - {task: on_right, skill: work, robot: right, arguments: {work: right, seconds: 0.2}, retries: 3}
            - wait: 0.1
          while: left.go_on > 0
  - {task: end, skill: work, robot: right, arguments: {work: end}, retries: 3}
"""
HEAD = f"parameters: {{odd: {{default: {FAILS_EVERY_OTHER_TIME}}}}}\n"
RUNS = ("a", "b")


@pytest.mark.timeout(300)
@pytest.mark.parametrize(("works", "kills", "seed"), [(SECURED, 10, 41)], indirect=["works"])
async def test_nothing_is_done_twice_and_nothing_is_lost(works: Plant, kills: int, seed: int) -> None:
    await works.prepare()
    works.scenario("busy", STEPS, HEAD)
    crew = crew_of(works, seed)
    await crew.begin(SERVER, *ROBOTS)
    async with works.client() as client:
        await all_heard(client)
        run_ids = [await run(client, "busy", {"odd": f"{FAILS_EVERY_OTHER_TIME} {name}"}) for name in RUNS]
    async with asyncio.TaskGroup() as killers:
        killers.create_task(crew.kill((SERVER,), kills, 0.2, 1.5))
        killers.create_task(crew.kill(ROBOTS, kills, 0.2, 2.0))
    async with works.client() as client:
        await stop(client)
        for run_id in run_ids:
            assert await run_is(client, run_id, "done", "failed", "aborted") == "done", await value(
                client, f"Scenarios.Runs.{run_id}.Reason"
            )
    crew.end()

    facts = facts_of(works.folder / works.config.server.state_dir / RUN_JOURNAL)
    told = [(robot, job.execution_id.hex()) for robot, machine in works.machines.items() for job in machine.told()]
    ledger = keep(facts, told)
    print(f"{len(crew.kills)} kills, {ledger}")
    assert Counter("server" if name == SERVER else "bridge" for _, name in crew.kills) == {
        "server": kills,
        "bridge": kills,
    }
    assert crew.kills[-1][0] < min(fact.at for fact in facts if isinstance(fact, RunEnded)), "all kills within the runs"
    assert (ledger.doubled, ledger.lost, ledger.invented, ledger.unknown) == ([], [], [], 0)
    assert ledger.assigned == ledger.done + ledger.failed + ledger.never_begun > 2 * kills

    # What was to be done was done, and only that: each attempt that was begun is one line in a machine's log.
    outcomes = Counter(fact.outcome for fact in facts if isinstance(fact, TaskOver))
    assert len(told) == outcomes[TaskOutcome.DONE] + outcomes[TaskOutcome.FAILED]
    odd = [fact.task for fact in facts if isinstance(fact, TaskAssigned)].count("odd")
    assert 0 < outcomes[TaskOutcome.FAILED] <= odd
    for name in ("begin", "end"):
        assert [work for _, work in works.told()].count(name) == len(RUNS)
