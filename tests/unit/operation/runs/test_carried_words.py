"""What a person says of a run while a bridge is being asked something else."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.operation.runs.test_carried import AWAY_S, Carried, page
from ua_fleet.operation.runs.carried import HEARD_FOLLOW_S
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import RunPaused, StepStarted, encode_fact


@pytest.mark.parametrize("is_heard", [False, True])
def test_a_bridge_that_is_being_asked_is_told_at_once_that_the_run_is_paused(tmp_path: Path, is_heard: bool) -> None:
    world = Carried(tmp_path)
    run_id = world.begin()
    if is_heard:
        for space in (300, 301, 302):
            world.tell_token(space, run_id, ())
    world.bridges.does[301, Word.FETCH] = None
    world.go(HEARD_FOLLOW_S + 1)
    assert [space for space, *_ in world.bridges.open] == [301]
    for says in (world.carried.pause, world.carried.resume):
        says(run_id, "anna")
        asked = world.asked(0.5)
        assert (300, Word.PAUSE) in asked
        assert (301, Word.PAUSE) not in asked, "one question after the other"
        world.bridges.does.clear()
        assert (301, Word.PAUSE) in world.asked(0.5)
        world.bridges.does[301, Word.FETCH] = None
        world.go(HEARD_FOLLOW_S + 1)
    assert not world.mistakes.count, world.mistakes.text()


@pytest.mark.parametrize("word", [Word.PART, Word.TOKEN])
@pytest.mark.parametrize("is_resumed", [False, True])
def test_a_run_is_paused_before_its_first_bridge_has_said_that_it_has_begun(
    tmp_path: Path, word: Word, is_resumed: bool
) -> None:
    world = Carried(tmp_path)
    world.bridges.does[300, word] = None
    run_id = world.offer()
    world.go(1.0)
    world.carried.pause(run_id, "anna")
    if is_resumed:
        world.carried.resume(run_id, "anna")
    assert not [one for one in world.asked(1.0) if one[1] is Word.PAUSE], "it is not known there yet"
    world.bridges.does.clear()
    told = [space for space, asked in world.asked(5.0) if asked is Word.PAUSE]
    assert sorted(told) == [300, 301, 302]
    assert len(world.facts(RunPaused)) == 1
    assert not world.mistakes.count, world.mistakes.text()


def test_a_bridge_that_is_being_asked_is_told_at_once_of_the_next_one_that_is_off(tmp_path: Path) -> None:
    world = Carried(tmp_path, 4)
    run_id = world.begin()
    world.bridges.off |= {302, 303}
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c2", (), "anna")
    world.go(1.0)
    world.bridges.does[301, Word.FETCH] = None
    world.go(HEARD_FOLLOW_S + 1)
    assert 301 in [space for space, *_ in world.bridges.open]
    world.carried.adopt(run_id, "c3", (), "anna")
    assert (301, Word.ADOPT) not in world.asked(0.5)
    world.bridges.does.clear()
    assert (301, Word.ADOPT) in world.asked(0.5)


def test_news_that_a_bridge_tells_while_it_is_asked_are_fetched_at_once(tmp_path: Path) -> None:
    world = Carried(tmp_path)
    run_id = world.begin()
    for space in (300, 301, 302):
        world.tell_token(space, run_id, ())
    world.bridges.does[301, Word.FETCH] = None
    world.tell_token(301, run_id, (), count=1)
    world.go(1.0)
    assert [space for space, *_ in world.bridges.open] == [301]
    world.tell_token(301, run_id, (), count=2)  # its answer is on the way already, without the second
    world.bridges.does[301, Word.FETCH] = page(encode_fact(StepStarted(50.0, "1")))
    assert world.asked(1.0).count((301, Word.FETCH)) == 1
    assert (301, Word.FETCH) not in world.asked(5.0), "once"
    assert not world.mistakes.count, world.mistakes.text()
