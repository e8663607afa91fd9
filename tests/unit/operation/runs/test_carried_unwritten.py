"""The server's disk is full: what it has not written down it tells no bridge, and no adoption goes without it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from tests.unit.operation.runs.test_carried import AWAY_S, Carried, adopted_by, page
from ua_fleet.errors import StorageUnavailable
from ua_fleet.operation.runs.carried import OFFER_S
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import (
    RunAdopted,
    RunClosing,
    RunEnded,
    RunOutcome,
    RunPaused,
    StepEnded,
    StepState,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
    encode_fact,
)

DONE = (
    encode_fact(TaskAssigned(10.0, "1", "t1", 1, "r1", "ff" * 16, "work")),
    encode_fact(TaskOver(11.0, "1", 1, TaskOutcome.DONE, Then.DONE)),
    encode_fact(StepEnded(11.0, "1", StepState.DONE)),
)
"""What c1 has done."""


@pytest.fixture
def world(tmp_path: Path) -> Iterable[Carried]:
    made = Carried(tmp_path)
    yield made
    assert not made.mistakes.count, made.mistakes.text()


def heal(world: Carried) -> None:
    """The disk has room again, and what waits is written."""
    world.journal.fails = False
    world.pass_time(2.0)


def words(world: Carried) -> set[Word]:
    """What bridges have been told, or asked for."""
    return {word for _, word in world.bridges.asked}


def test_an_heir_is_not_told_before_all_that_was_fetched_is_written(world: Carried) -> None:
    run_id = world.begin()
    world.journal.fails = True
    world.bridges.does[301, Word.FETCH] = page(*DONE)
    world.go(11.0)
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    with pytest.raises(StorageUnavailable):
        world.carried.adopt(run_id, "c1", (), "anna")
    world.go(6.0)
    assert Word.ADOPT not in words(world)
    heal(world)
    world.carried.adopt(run_id, "c1", (), "anna")
    world.go(6.0)
    assert adopted_by(world, 300).facts == {"1": DONE}
    assert len(world.facts(StepEnded)) == 1, "it is shown once"


def test_an_adoption_is_not_told_before_it_is_written(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    world.journal.fails = True
    with pytest.raises(StorageUnavailable):
        world.carried.adopt(run_id, "c1", (), "anna")
    world.go(6.0)
    assert Word.ADOPT not in words(world)
    heal(world)
    assert not world.facts(RunAdopted)
    assert not [fact for fact in world.service.facts_of(run_id) if isinstance(fact, RunAdopted)], "it never was"
    assert world.carried.adopt(run_id, "c1", (), "anna") == "c0"
    world.go(6.0)
    assert (adopted_by(world, 300).part.epoch, len(world.facts(RunAdopted))) == (2, 1)


def pauses(world: Carried, run_id: str) -> None:
    world.carried.pause(run_id, "anna")


def aborts(world: Carried, run_id: str) -> None:
    world.carried.abort(run_id, "enough", "anna")


@pytest.mark.parametrize(
    ("says", "word", "fact"), [(pauses, Word.PAUSE, RunPaused), (aborts, Word.END, RunClosing)], ids=["pause", "abort"]
)
def test_what_a_person_says_of_a_run_is_not_told_before_it_is_written(
    world: Carried, says: Callable[[Carried, str], None], word: Word, fact: type
) -> None:
    run_id = world.begin()
    world.journal.fails = True
    with pytest.raises(StorageUnavailable):
        says(world, run_id)
    world.go(6.0)
    assert word not in words(world)
    heal(world)
    assert not world.facts(fact)
    says(world, run_id)
    world.go(1.0)
    assert word in words(world)
    assert len(world.facts(fact)) == 1


def test_a_run_that_is_over_does_not_end_without_a_bridge_before_that_is_written(world: Carried) -> None:
    run_id = world.begin()
    world.bridges.off.add(301)
    world.bridges.does |= {(space, Word.FETCH): page(closed="done") for space in (300, 302)}
    world.go(AWAY_S + 10)
    world.journal.fails = True
    with pytest.raises(StorageUnavailable):
        world.carried.adopt(run_id, "c1", (), "anna")
    world.go(6.0)
    heal(world)
    assert world.carried.has(run_id)
    assert world.carried.adopt(run_id, "c1", (), "anna") == ""
    world.go(1.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]


def test_an_end_of_the_server_is_told_once_it_is_written(world: Carried) -> None:
    world.bridges.off.add(302)
    world.offer()
    world.journal.fails = True
    world.go(OFFER_S + 20)
    assert Word.END not in words(world)
    world.journal.fails = False
    world.bridges.off.clear()
    world.bridges.does[302, Word.PART] = None
    world.go(10.0)
    assert Word.END in words(world)
    assert [fact.outcome for fact in world.facts(RunClosing)] == [RunOutcome.FAILED]
