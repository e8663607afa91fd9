"""Machines that cannot be asked: what a kill leaves open is Unknown, and `on_unknown` decides."""

from __future__ import annotations

import asyncio
from collections import Counter
from random import Random
from typing import Any

import pytest
from asyncua.client.client import Client

from tests.integration.kills.conftest import SECURED, Crew, crew_of, stop
from tests.integration.kills.ledger import facts_of, keep
from tests.integration.scenarios.conftest import ROBOTS, Plant, all_heard, call, run, run_is
from tests.integration.server_model.harness import until
from ua_fleet.scenario.facts import Replaced, TaskAnswered, TaskOutcome, TaskOver, Then

WORK_S = 0.8
POLICIES = {"left": "retry", "middle": "ask", "right": "replace"}
STEPS = "  - parallel:\n" + "".join(
    f"      - - repeat: [{{task: t_{robot}, skill: work, robot: {robot}, on_unknown: {policy},"
    f" arguments: {{work: for {robot}, seconds: {WORK_S}}}}}]\n"
    "          while: go_on > 0\n"
    for robot, policy in POLICIES.items()
)


class Operators:
    """What people do about what nobody can tell."""

    def __init__(self, plant: Plant, crew: Crew, client: Client, run_id: str, random: Random) -> None:
        self._plant, self._crew, self._client, self._run_id, self._random = plant, crew, client, run_id, random

    async def is_told(self, robot: str) -> None:
        """Wait until a machine is told something."""
        machine = self._plant.machines[robot]
        before = len(machine.told())

        async def told() -> Any:
            return len(machine.told())

        await until(told, lambda count: count > before)

    async def kill_at_work(self, robot: str) -> None:
        """Kill a bridge at a random moment of what its machine is at."""
        await self.is_told(robot)
        await asyncio.sleep(self._random.uniform(0.0, WORK_S / 2))
        await self._crew.kill_now(robot)

    async def clear(self, robot: str) -> None:
        """Say that a machine stands which can never tell whether it was halted."""

        async def faults() -> Any:
            nodes = await self._client.get_node("ns=2;s=Fleet.Faults").get_children()
            return [(await node.read_browse_name()).Name for node in nodes]

        await until(faults, lambda found: f"{robot}.not_halted" in found, timeout_s=60)
        assert (await call(self._client, "Faults", "ClearFault", robot)).status == 0

    async def answer(self, task: str, answer: str) -> None:
        """Say what became of a task, once it is asked."""

        async def state() -> Any:
            run = f"ns=2;s=Fleet.Scenarios.Runs.{self._run_id}"
            columns = [self._client.get_node(f"{run}.{column}") for column in ("Tasks", "States")]
            names, states = await self._client.read_values(columns)
            is_whole = len(names) == len(states)  # one column is written after the other
            return [state for name, state in zip(names, states, strict=is_whole) if name == task][-1:]

        await until(state, lambda shown: shown == ["asked"])
        assert (await call(self._client, "Scenarios", "Answer", self._run_id, task, answer)).status == 0


@pytest.mark.timeout(300)
@pytest.mark.parametrize("works", [SECURED], indirect=True)
async def test_what_a_forgetful_machine_was_at_is_unknown_and_decided_as_the_task_says(works: Plant) -> None:
    await works.prepare()
    works.scenario("forgotten", STEPS)
    for machine in works.machines.values():
        machine.forget()
    crew = crew_of(works, 7)
    async with works.server() as server:
        await crew.begin(*ROBOTS)
        async with server.client() as client:
            await all_heard(client)
            run_id = await run(client, "forgotten")
            operators = Operators(works, crew, client, run_id, Random(7))
            await operators.kill_at_work("left")
            await operators.answer("t_left", "done")  # it could do it twice: nobody knows, so it is not asked again
            await operators.kill_at_work("middle")
            await operators.answer("t_middle", "done")
            await operators.kill_at_work("right")
            await operators.clear("right")
            await operators.is_told("right")  # whoever took its task over has done it, and that one only
            await stop(client)
            assert await run_is(client, run_id, "done", "failed", "aborted") == "done"
    crew.end()

    facts = facts_of(works.folder / works.config.server.state_dir)
    told = [(robot, job.execution_id.hex()) for robot, machine in works.machines.items() for job in machine.told()]
    ledger = keep(facts, told)
    print(f"{len(crew.kills)} kills, {ledger}")
    assert (ledger.doubled, ledger.lost, ledger.invented) == ([], [], [])
    assert len(ledger.unknown) == len(crew.kills) == 3
    unknown = [fact for fact in facts if isinstance(fact, TaskOver) and fact.outcome is TaskOutcome.UNKNOWN]
    assert Counter(fact.then for fact in unknown) == {Then.ASK: 2, Then.REPLACE: 1}
    assert all("the machine remembers nothing of it" in fact.message for fact in unknown)
    assert [fact.then for fact in facts if isinstance(fact, TaskAnswered)] == [Then.DONE, Then.DONE]
    assert {fact.failed for fact in facts if isinstance(fact, Replaced)} == {"right"}, "also while it owes a halt"
    assert ledger.assigned == ledger.done + len(ledger.unknown) == len(told)
