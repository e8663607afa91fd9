"""Real kills at random moments of scenarios: what robots were told is what the server has written down.

With those of the other files of this folder the server is killed ten times, and bridges are too.
"""

from __future__ import annotations

import asyncio
from collections import Counter

import pytest

from tests.integration.kills.conftest import SECURED, SERVER, crew_of, ended, stop
from tests.integration.kills.ledger import facts_of, keep
from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, run, value
from tests.integration.scenarios.machines import FAILS_EVERY_OTHER_TIME
from ua_fleet.scenario.facts import RunEnded, TaskAssigned

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
@pytest.mark.parametrize(("works", "server_kills", "bridge_kills", "seed"), [(SECURED, 8, 5, 41)], indirect=["works"])
async def test_nothing_is_done_twice_and_nothing_is_lost(
    works: Plant, server_kills: int, bridge_kills: int, seed: int
) -> None:
    await works.prepare()
    works.scenario("busy", STEPS, HEAD)
    crew = crew_of(works, seed)
    await crew.begin(SERVER, *ROBOTS)
    async with works.client() as client:
        await all_heard(client)
        run_ids = [await run(client, "busy", {"odd": f"{FAILS_EVERY_OTHER_TIME} {name}"}) for name in RUNS]
    async with asyncio.TaskGroup() as killers:
        killers.create_task(crew.kill((SERVER,), server_kills, 1.5, after_all=True))
        killers.create_task(crew.kill(ROBOTS, bridge_kills, 4.0))
    async with works.client() as client:
        await stop(client)
        for run_id in run_ids:
            assert await ended(client, run_id) == "done", await value(client, f"Scenarios.Runs.{run_id}.Reason")
        replayed = [f"ns=2;s={900 + number}.Drops.replayed" for number in range(len(ROBOTS))]
        nodes = [client.get_node(node_id) for node_id in ("ns=2;s=Fleet.Traffic.Drops.replayed", *replayed)]
        assert await client.read_values(nodes) == [0] * 4, "nonces go on where they were, whoever was killed"
    crew.end()

    facts = facts_of(works.folder / works.config.server.state_dir)
    told = [(robot, job.execution_id.hex()) for robot, machine in works.machines.items() for job in machine.told()]
    ledger = keep(facts, told)
    print(f"{len(crew.kills)} kills, {ledger}")
    assert Counter("server" if name == SERVER else "bridge" for _, name in crew.kills) == {
        "server": server_kills,
        "bridge": bridge_kills,
    }
    assert crew.kills[-1][0] < min(fact.at for fact in facts if isinstance(fact, RunEnded)), "all kills within the runs"
    assert (ledger.doubled, ledger.lost, ledger.invented) == ([], [], [])
    assert not {execution_id for _, execution_id in told}.intersection(ledger.unknown), "these machines can be asked"
    ended_known = ledger.done + ledger.failed + ledger.never_begun
    assert ledger.assigned == ended_known + len(ledger.unknown)
    assert ended_known > 2 * len(crew.kills)

    # What was to be done was done, and only that: each attempt that was begun is one line in a machine's log.
    assert len(told) == ledger.done + ledger.failed
    assert 0 < ledger.failed <= [fact.task for fact in facts if isinstance(fact, TaskAssigned)].count("odd")
    for name in ("begin", "end"):
        assert [work for _, work in works.told()].count(name) == len(RUNS)
