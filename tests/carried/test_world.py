"""Carried runs in a world that is bad to them, each decided by its seed; and wrong ones, which must be found."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import pytest

from tests.carried.judge import problems_of
from tests.carried.world import ADOPT_S, RUN, World
from ua_fleet.carrying import Part, encode_part, parts_of
from ua_fleet.carrying.facts import PauseTold
from ua_fleet.carrying.part import PartSegment, Road, decode_part
from ua_fleet.carrying.plan import Segment
from ua_fleet.carrying.whole_plan import plan_of
from ua_fleet.carrying.whole_repeats import InnerRounds
from ua_fleet.operation.runs.adopting import Adopting
from ua_fleet.scenario.effects import StartTask
from ua_fleet.scenario.facts import Fact

FEW: Final = 400
"""Seeds of the usual test run, which has little time."""
BATCH: Final = 100
WRONG: Final = 80
"""Seeds within which each wrong implementation is to be found."""


def _seeds() -> list[int]:
    """Those that are asked for: `0-1999`, or `17,44`."""
    found: list[int] = []
    for part in os.environ.get("UA_FLEET_CARRIED_SEEDS", f"0-{FEW - 1}").split(","):
        first, _, last = part.partition("-")
        found += range(int(first), int(last or first) + 1)
    return found


_ALL: Final = _seeds()
BATCHES: Final = [_ALL[start : start + BATCH] for start in range(0, len(_ALL), BATCH)]


def judged(seed: int, **wrong: Any) -> list[str]:
    """What is wrong with the world of a seed; nothing where its scenario cannot be carried."""
    world = World(seed, **wrong)
    if world.problems:
        return []
    world.run()
    return problems_of(world)


@pytest.mark.parametrize("seeds", BATCHES, ids=lambda seeds: f"{seeds[0]}-{seeds[-1]}")
def test_every_run_ends_as_it_would_orchestrated_and_nothing_is_done_twice(seeds: list[int]) -> None:
    found = {seed: problems for seed in seeds if (problems := judged(seed))}
    said = f"run them alone: UA_FLEET_CARRIED_SEEDS={','.join(map(str, found))} .venv/bin/python -m pytest {__file__}"
    assert not found, f"{found}\n{said}"


def test_rounds_that_a_bridge_has_done_alone_before_it_was_off_are_not_done_again() -> None:
    found = {seed: problems for seed in range(WRONG) if (problems := judged(seed, is_alone=True))}
    assert not found, found


def test_people_are_asked_for_rounds_that_a_bridge_may_have_done_alone() -> None:
    worlds = [world for seed in range(20) if not (world := World(seed, is_alone=True)).problems]
    for world in worlds:
        world.run()
    assert sum(world.asked > 0 for world in worlds) >= 3


def test_worlds_are_bad_and_scenarios_are_of_all_kinds() -> None:
    worlds = [World(seed) for seed in range(60)]
    carried = [world for world in worlds if not world.problems]
    assert len(carried) >= 45

    def have(is_such: Callable[[Segment], bool]) -> int:
        return sum(any(is_such(segment) for segment in world.plan.segments) for world in carried)

    assert have(lambda one: one.slots > 1 and not one.tells) >= 12
    assert have(lambda one: bool(one.loops)) >= 6
    assert have(lambda one: one.slots > 1 and not one.tells and bool(one.loops)) >= 2
    assert have(lambda one: bool(one.otherwise) and not one.loops) >= 6
    assert have(lambda one: bool(one.tells)) >= 6
    assert sum(bool(world.robots.broken) for world in carried) >= 15
    for world in carried:
        world.run()
    assert sum(world.kills for world in carried) >= 60
    assert sum(world.refused for world in carried) >= 60
    assert sum(world.compacted > 0 for world in carried) >= 5
    assert sum(world.server_dies_at < 900 for world in carried) >= 15
    assert sum(bool(world.still) for world in carried) >= 5
    assert sum(world.offs[0].is_done for world in carried) >= 5
    assert sum(world.adoptions > 1 for world in carried) >= 2
    assert sum(off.is_both and off.is_done for world in carried for off in world.offs) >= 1


def test_a_plan_is_made_again_of_all_its_parts() -> None:
    worlds = [world for seed in range(60) if not (world := World(seed, is_alone=seed % 3 == 0)).problems]
    assert len(worlds) >= 45
    for world in worlds:
        read = {space: decode_part(encode_part(part)) for space, part in world.parts.items()}
        again = parts_of(plan_of(read), RUN, "made", {}, "x", adopt_after_s=ADOPT_S)
        assert plan_of(read).last == world.plan.last
        assert {space: encode_part(part) for space, part in again.items()} == {
            space: encode_part(part) for space, part in world.parts.items()
        }


def is_found(seeds: int = WRONG, **wrong: Any) -> bool:
    """Whether any world finds it."""
    return any(judged(seed, **wrong) for seed in range(seeds))


def test_a_journal_that_is_written_after_sending_is_found() -> None:
    assert is_found(is_lazy=True)


def test_execution_ids_without_the_attempt_are_found() -> None:
    assert is_found(identity=_without_attempt)


def test_a_join_at_two_bridges_is_found() -> None:
    assert is_found(parts=_two_joins)


def test_a_pause_that_is_not_written_down_is_found() -> None:
    assert is_found(FEW, forgets=PauseTold)


def test_an_adoption_without_an_epoch_is_found() -> None:
    assert is_found(FEW, no_epoch=True)


def test_an_adoption_that_does_not_know_what_nobody_has_heard_of_to_be_over_is_found() -> None:
    assert is_found(is_alone=True, has_proof=False)


def test_an_adoption_that_begins_no_round_that_a_person_names_within_a_segment_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(_self: InnerRounds, _step: str, _at: float) -> list[Fact]:
        return []

    monkeypatch.setattr(InnerRounds, "begin", nothing)
    assert is_found(is_alone=True)


def test_a_server_that_does_not_ask_for_rounds_that_nobody_has_heard_of_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing(_self: Adopting) -> None: ...

    monkeypatch.setattr(Adopting, "unknown_rounds", nothing)
    assert is_found(is_alone=True)


def test_execution_ids_without_the_round_are_found() -> None:
    assert is_found(identity=_without_round)


def test_a_holder_that_forgets_what_it_could_not_write_is_found() -> None:
    assert is_found(forgets_again=True)


def _without_attempt(effect: StartTask, _attempt: int) -> str:
    return f"{effect.robot}/{effect.step}"


def _without_round(effect: StartTask, attempt: int) -> str:
    return f"{effect.robot}/{effect.step.partition('@')[0]}/{attempt}"


def _two_joins(parts: dict[int, Part]) -> dict[int, Part]:
    """Every branch but the first ends at a copy of its join that another bridge has; each begins with what it gets."""
    joins = {
        one.number: (space, one)
        for space, part in parts.items()
        for one in part.segments.values()
        if one.slots > 1 and not one.tells
    }
    if not joins or len(parts) < 2:
        return parts
    made = {space: dict(part.segments) for space, part in parts.items()}

    def other(space: int) -> int:
        return next(each for each in parts if each != space)

    for number, (space, join) in joins.items():
        for at in (space, other(space)):
            made[at][number] = replace(join, slots=1, needs=join.needs[:1])

    def turned(road: Road) -> Road:
        if road.segment not in joins:
            return road
        home = joins[road.segment][0]
        return replace(road, slot=0, space=home if road.slot == 0 else other(home))

    def of(segment: PartSegment) -> PartSegment:
        fails = None if segment.fails is None else turned(segment.fails)
        then, otherwise = tuple(map(turned, segment.then)), tuple(map(turned, segment.otherwise))
        return replace(segment, then=then, otherwise=otherwise, fails=fails)

    return {
        space: replace(part, segments={number: of(segment) for number, segment in made[space].items()})
        for space, part in parts.items()
    }
