"""Carried runs whose server is killed at any write of its own file: what it makes of them when it is back."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

from tests.carried.judge import problems_of
from tests.carried.server import ServedWorld, at_the_beginning, by_chance
from tests.carried.world import HEALED_S, RUN
from ua_fleet.carrying.holder import LOST
from ua_fleet.operation.runs.records import RunRecord
from ua_fleet.scenario.facts import RunClosing, RunEnded, RunOutcome, StepState

SEEDS: Final = range(40)
ON_THE_WAY_S: Final = 4.0
"""An answer and a token may cross for so long in the bad network."""


def problems_of_server(world: ServedWorld) -> list[str]:
    """What is wrong with what the server has made of the run."""
    found = problems_of(world)
    assert world.server is not None
    if world.server.mistakes.count:
        found.append(world.server.mistakes.text())
    facts, begun = world.facts, world.robots.begun
    closings = [fact for fact in facts if isinstance(fact, RunClosing)]
    if closings and begun and begun[0].at < closings[0].at - ON_THE_WAY_S:
        found.append(f"the server closes it at {closings[0].at:.1f}, and it began at {begun[0].at:.1f}: {closings}")
    ends = [fact for fact in facts if isinstance(fact, RunEnded)]
    if len(ends) != 1:
        return [*found, f"the server has {len(ends)} ends"]
    said = {held.closed.outcome for one in world.bridges.values() if (held := one.holder.runs.get(RUN)) and held.closed}
    if not closings and said - {LOST} != {ends[0].outcome.value}:
        found.append(f"bridges say {said}, and the server {ends[0]}")
    if ends[0].outcome is RunOutcome.DONE:
        record = RunRecord.of(RUN, facts)
        done = {step for step, state in record.state.ended.items() if state is StepState.DONE}
        # Bridges of this world keep nothing of rounds that are over.
        known = [one.step for one in begun if not one.fails and "@" not in one.step]
        found += [f"{step} is not shown as done" for step in known if step not in done]
    return found


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_server_that_is_killed_when_the_first_token_was_taken_follows_the_run(tmp_path: Path, when: str) -> None:
    """With that write alone: the bridges go on meanwhile, and are killed as in other worlds."""
    wrong: dict[int, list[str]] = {}
    kills = done = 0
    for seed in SEEDS:
        world = ServedWorld(seed, tmp_path, at_the_beginning(when))
        if world.problems:
            continue
        world.run()
        kills += world.server_kills
        done += bool(world.robots.begun)
        if problems := problems_of_server(world):
            wrong[seed] = problems
    assert not wrong
    assert kills > len(SEEDS) / 3
    assert done >= kills


def test_a_server_that_is_killed_at_any_write_has_each_run_to_its_end(tmp_path: Path) -> None:
    wrong: dict[int, list[str]] = {}
    kills = 0
    for seed in SEEDS:
        world = ServedWorld(seed, tmp_path, by_chance(seed))
        if world.problems:
            continue
        world.run()
        assert world.now > HEALED_S
        kills += world.server_kills
        if problems := problems_of_server(world):
            wrong[seed] = problems
    assert not wrong
    assert kills > len(SEEDS) / 3
