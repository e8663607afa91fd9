"""A server that is started again after an adoption which all bridges know, or while they are told of it."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from tests.unit.operation.runs.test_carried import AWAY_S, Carried, adopted_by, answer, page
from tests.unit.operation.runs.test_carried_rounds import SELDOM, TASK, began, repeated
from ua_fleet.carrying.adoption import FilledSlot, encode_filled
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.errors import ScenarioError
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import (
    AdoptionTold,
    RunAdopted,
    RunEnded,
    RunOutcome,
    StepEnded,
    StepState,
    decode_fact,
    encode_fact,
)
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.values import StatusCode

NOT_KNOWN = RequestOutcome(
    OutcomeKind.REFUSED, ExecutionReport(ExecutionState.FAILED, StatusCode.BAD_NOT_FOUND, "the run is not known here")
)


def adopted(folder: Path, *, is_told: bool = True) -> str:
    """A server of four bridges that ends when all know that c1 is off, or before its heir does: the run."""
    world = Carried(folder, 4)
    run_id = world.begin()
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    if not is_told:
        world.bridges.does |= {(space, Word.ADOPT): None for space in (300, 302, 303)}
    assert world.carried.adopt(run_id, "c1", (), "anna") == "c0"
    world.go(3.0)
    assert len(world.facts(AdoptionTold)) == is_told
    world.journal.close()
    return run_id


def again(folder: Path) -> Carried:
    """The next server, in whose file c3 is no more, and whose other bridges say that all is done."""
    world = Carried(folder, 3)
    world.bridges.off.add(301)
    return world


def test_an_adoption_that_all_know_is_not_told_once_more(tmp_path: Path) -> None:
    run_id = adopted(tmp_path)
    world = again(tmp_path)
    asked = world.asked(6.0)
    assert not [space for space, word in asked if word is Word.ADOPT]
    assert {(300, Word.FETCH), (302, Word.FETCH)} <= set(asked), "it is followed"
    world.carried.pause(run_id, "anna")
    world.carried.resume(run_id, "anna")
    world.go(AWAY_S)
    assert world.carried.adopt(run_id, "space 303", (), "anna") == "c0", "the next one"
    world.go(1.0)
    assert [fact.also for fact in world.facts(RunAdopted)] == [()]
    world.bridges.does |= {(space, Word.FETCH): page(closed="done") for space in (300, 302)}
    world.go(6.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]
    assert not world.mistakes.count, world.mistakes.text()


@pytest.mark.parametrize("is_told", [True, False])
def test_a_run_that_is_over_ends_though_a_bridge_that_has_to_know_of_an_adoption_has_left_the_file(
    tmp_path: Path, is_told: bool
) -> None:
    """Also one whose adoption was all known to a server that did not write that down."""
    run_id = adopted(tmp_path, is_told=is_told)
    world = again(tmp_path)
    fact = encode_fact(StepEnded(60.0, "2", StepState.DONE))
    world.bridges.does |= {(300, Word.FETCH): page(closed="done"), (302, Word.FETCH): page(fact, closed="done")}
    world.go(AWAY_S)
    (ended,) = world.facts(RunEnded)
    assert ended.outcome is RunOutcome.DONE
    assert len(world.facts(StepEnded)) == 1, "what was fetched meanwhile is shown"
    assert not world.carried.has(run_id)
    assert not world.mistakes.count, world.mistakes.text()


def test_only_the_heir_of_an_adoption_that_waits_may_know_that_the_run_is_over(tmp_path: Path) -> None:
    adopted(tmp_path, is_told=False)
    world = again(tmp_path)
    world.bridges.off.add(302)
    world.go(1.0)
    assert "c0: it goes on once all others know which bridge is off" in world.reason()
    world.go(6.0)
    assert "c0: it goes on once all others know which bridge is off" in world.reason(), "though it has answered"
    world.bridges.does[300, Word.FETCH] = page(closed="done")
    world.go(6.0)
    world.bridges.off.discard(302)
    world.bridges.does[302, Word.FETCH] = page(closed="done")
    world.go(6.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]


def test_a_heir_that_is_asked_meanwhile_is_told_as_soon_as_all_others_know(tmp_path: Path) -> None:
    adopted(tmp_path, is_told=False)
    world = Carried(tmp_path, 4)
    world.bridges.off.add(301)
    world.bridges.does |= {(303, Word.ADOPT): None, (300, Word.FETCH): None}
    world.go(1.0)
    world.bridges.does.pop((303, Word.ADOPT))
    world.go(1.0)
    assert (300, Word.ADOPT) not in world.bridges.asked, "one question after the other"
    world.bridges.does.clear()
    assert (300, Word.ADOPT) in world.asked(0.5)


def test_an_adoption_that_waits_for_a_bridge_which_has_left_the_file_goes_on_without_both_or_is_aborted(
    tmp_path: Path,
) -> None:
    run_id = adopted(tmp_path, is_told=False)
    world = again(tmp_path)
    world.go(AWAY_S + 1)
    with pytest.raises(ScenarioError, match="is adopting"):
        world.carried.pause(run_id, "anna")
    assert f"ua-fleet scenario adopt {run_id} 'space 303' --off" in world.reason()
    assert world.carried.adopt(run_id, "space 303", (), "anna") == "c0"
    world.go(1.0)
    assert len(world.facts(AdoptionTold)) == 1
    world.carried.abort(run_id, "", "anna")
    world.go(1.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


@pytest.mark.parametrize("outcome", [RunOutcome.DONE, RunOutcome.FAILED])
def test_a_run_that_is_over_ends_without_a_bridge_that_is_off_for_good(tmp_path: Path, outcome: RunOutcome) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.bridges.off.add(301)
    world.bridges.does |= {(space, Word.FETCH): page(closed=outcome.value) for space in (300, 302)}
    world.go(AWAY_S + 10)
    assert "c1 --off" in world.reason()
    assert "have the run end without it" in world.reason()
    assert world.carried.adopt(run_id, "c1", (), "anna") == "", "nobody goes on"
    world.go(6.0)
    (ended,) = world.facts(RunEnded)
    assert (ended.outcome, "c1 did not know it" in ended.reason) == (outcome, True)
    assert not world.mistakes.count, world.mistakes.text()
    world.bridges.off.discard(301)
    assert (301, Word.END) in world.asked(30.0), "it is told when it is there"


@pytest.mark.parametrize("outcome", [RunOutcome.DONE, RunOutcome.FAILED])
def test_a_server_that_is_started_again_tells_a_bridge_that_was_off_how_bridges_have_ended_the_run(
    tmp_path: Path, outcome: RunOutcome
) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.bridges.off.add(301)
    world.bridges.does |= {(space, Word.FETCH): page(closed=outcome.value) for space in (300, 302)}
    world.go(AWAY_S + 10)
    world.carried.adopt(run_id, "c1", (), "anna")
    world.go(6.0)
    assert world.facts(RunEnded)
    world.journal.close()
    last = Carried(tmp_path, 3)
    last.go(6.0)
    (told,) = [content for space, word, content in last.bridges.contents if (space, word) == (301, Word.END)]
    assert decode_words(told)["outcome"] == outcome.value


def test_a_run_that_is_over_ends_though_a_bridge_does_not_know_it_any_more(tmp_path: Path) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.bridges.does[302, Word.FETCH] = NOT_KNOWN
    world.go(6.0)
    assert "c2: the run is not known here" in world.reason()
    assert world.carried.has(run_id), "nobody has said that it is over"
    step = StepEnded(40.0, "1", StepState.DONE)
    world.bridges.does |= {
        (300, Word.FETCH): page(encode_fact(step), closed="done"),
        (301, Word.FETCH): page(closed="done"),
    }
    world.go(6.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]
    assert step in world.service.facts_of(run_id), "what the others have told is written down before"


def test_a_run_for_which_one_bridge_has_waited_too_long_can_be_aborted_alone(tmp_path: Path) -> None:
    world = Carried(tmp_path, 3)
    run_id = world.begin()
    world.bridges.off.add(301)
    world.bridges.does[302, Word.FETCH] = page(closed="lost")
    world.go(AWAY_S + 10)
    assert "--off" not in world.reason()
    assert f"abort it: ua-fleet scenario abort {run_id}" in world.reason()
    with pytest.raises(ScenarioError):
        world.carried.adopt(run_id, "c1", (), "anna")
    assert not world.facts(RunEnded)


def test_that_all_know_of_an_adoption_is_read_again() -> None:
    assert decode_fact(encode_fact(AdoptionTold(7.0))) == AdoptionTold(7.0)


def has_tokens(count: int, loops: tuple[int, ...]) -> RequestOutcome:
    """A bridge knows which one is off, and has tokens that failed for long reasons, within these repetitions."""
    random = Random(1)
    why = ["".join(chr(random.randrange(0x4E00, 0x9FFF)) for _ in range(300)) for _ in range(count)]
    slots = [FilledSlot(number, 0, text, {}, (1,) * len(loops), loops) for number, text in enumerate(why)]
    return answer(encode_words(filled=encode_filled(slots)))


def test_what_others_have_is_too_large_for_the_heir(tmp_path: Path) -> None:
    """That is known only once they have said it: the adoption is written down by then."""
    world = Carried(tmp_path, 3)
    run_id = began(world, repeated(TASK, SELDOM))
    world.bridges.does[302, Word.ADOPT] = has_tokens(120, (1,))
    assert world.carried.adopt(run_id, "c1", ("one@none",), "anna") == "c0"
    world.go(1.0)
    asked = world.asked(12.0)
    assert (300, Word.ADOPT) not in asked
    assert {(300, Word.FETCH), (302, Word.FETCH)} <= set(asked), "one may know that the run is over"
    assert world.reason().startswith("c0: what the heir has to know has ")
    assert world.reason().endswith(f"; the run cannot go on, abort it: ua-fleet scenario abort {run_id}")
    assert not world.mistakes.count, world.mistakes.text()
    world.carried.abort(run_id, "", "anna")
    world.go(1.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_the_heir_is_told_of_tokens_alone_that_say_something_of_what_it_gets(tmp_path: Path) -> None:
    world = Carried(tmp_path, 3)
    run_id = began(world, repeated(TASK, SELDOM))
    world.bridges.does[302, Word.ADOPT] = has_tokens(120, ())
    assert world.carried.adopt(run_id, "c1", ("one@none",), "anna") == "c0"
    world.go(2.0)
    assert (300, Word.ADOPT) in world.bridges.asked
    told = adopted_by(world, 300)
    assert len(told.filled) < 10
    assert not world.mistakes.count, world.mistakes.text()


def test_what_was_fetched_of_a_run_that_is_aborted_is_written_down(tmp_path: Path) -> None:
    """Though a bridge has told nothing yet, whose facts may belong before it."""
    world = Carried(tmp_path, 3)
    step = StepEnded(40.0, "1", StepState.DONE)
    world.bridges.does |= {(300, Word.FETCH): page(encode_fact(step)), (301, Word.FETCH): NOT_KNOWN}
    run_id = world.begin()
    world.go(2.0)
    assert (300, Word.FETCH) in world.bridges.asked
    assert step not in world.service.facts_of(run_id), "it waits"
    world.carried.abort(run_id, "", "anna")
    world.go(2.0)
    assert not world.carried.has(run_id)
    assert step in world.service.facts_of(run_id)
