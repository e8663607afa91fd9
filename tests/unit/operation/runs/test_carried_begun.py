"""A server that ended while the first token of a carried run was on its way: the next one asks whether it began."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.unit.operation.runs.test_carried import AWAY_S, NOBODY, Carried, answer
from ua_fleet.carrying.words import decode_words, encode_words
from ua_fleet.errors import ScenarioError
from ua_fleet.operation.runs.carried import OFFER_S
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario.facts import RunClosing, RunEnded, RunOutcome, StepEnded, StepStarted, StepState, encode_fact
from ua_fleet.skill.executions import ExecutionReport, ExecutionState, OutcomeKind, RequestOutcome
from ua_fleet.values import StatusCode

UNKNOWN = RequestOutcome(
    OutcomeKind.REFUSED, ExecutionReport(ExecutionState.FAILED, StatusCode.BAD_NOT_FOUND, "run is not known here")
)
FAILS = RequestOutcome(
    OutcomeKind.REFUSED, ExecutionReport(ExecutionState.FAILED, StatusCode.BAD_INTERNAL_ERROR, "its disk fails")
)
FACT = encode_fact(StepEnded(60.0, "0", StepState.DONE))


def told(*facts: str, active: tuple[str, ...] = (), holds: tuple[str, ...] = (), closed: str = "") -> RequestOutcome:
    """What a bridge says that has its part."""
    words: dict[str, Any] = {"facts": facts, "last": len(facts), "more": False, "told": 0, "waits": "", "decisions": []}
    words |= {"active": active, "holds": holds, "closed": [60.0, closed, ""] if closed else None}
    return answer(zlib.compress(encode_words(**words)))


def killed(folder: Path, word: Word = Word.TOKEN) -> str:
    """A server that ends before it has heard the answer to a word: the run."""
    world = Carried(folder)
    world.bridges.does |= {(space, word): None for space in (300, 301, 302)}
    run_id = world.offer()
    world.go(1.0)
    assert (300, word) in world.bridges.asked
    assert not world.facts(StepStarted)
    world.journal.close()
    return run_id


def again(folder: Path, does: dict[int, RequestOutcome]) -> Carried:
    """The next server, whose bridges say this when they are asked what has become of the run."""
    world = Carried(folder)
    world.bridges.does |= {(space, Word.FETCH): outcome for space, outcome in does.items()}
    return world


def ends(world: Carried) -> list[str]:
    return [decode_words(content)["outcome"] for _, word, content in world.bridges.contents if word is Word.END]


@pytest.mark.parametrize(
    "first",
    [told(active=("0",)), told(holds=("0",)), told(FACT), told(FACT, closed="done")],
    ids=["under way", "has the token", "has done its part", "all is over"],
)
def test_a_run_that_has_begun_is_followed_by_the_next_server(tmp_path: Path, first: RequestOutcome) -> None:
    run_id = killed(tmp_path)
    world = again(tmp_path, {300: first})
    world.go(1.0)
    assert not ends(world), "it is not aborted"
    assert len(world.facts(StepStarted)) == 1, "it is known from now on that it has begun"
    world.bridges.does |= {(space, Word.FETCH): told(FACT, closed="done") for space in (300, 301, 302)}
    world.go(6.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]
    assert not world.carried.has(run_id)
    assert not world.mistakes.count, world.mistakes.text()


def test_that_a_run_has_begun_is_known_by_a_later_bridge_where_the_first_one_is_away(tmp_path: Path) -> None:
    run_id = killed(tmp_path)
    world = again(tmp_path, {301: told(FACT, active=("1",))})
    world.bridges.off.add(300)
    world.go(AWAY_S + 10)
    assert not ends(world)
    assert f"ua-fleet scenario adopt {run_id} c0 --off" in world.reason(), "it is followed"


@pytest.mark.parametrize("first", [told(), told(closed="lost")], ids=["waits", "waited too long"])
def test_a_run_that_has_not_begun_is_aborted_though_another_bridge_is_away(
    tmp_path: Path, first: RequestOutcome
) -> None:
    killed(tmp_path)
    world = again(tmp_path, {300: first})
    world.bridges.off.add(302)
    world.go(2.0)
    assert set(ends(world)) == {"aborted"}
    (closing,) = world.facts(RunClosing)
    assert closing.reason == "nothing was begun, as its bridges say"
    world.bridges.off.clear()
    world.go(2.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


@pytest.mark.parametrize(("first", "ended"), [(told(active=("0",)), []), (told(), [RunOutcome.ABORTED])])
def test_a_first_bridge_that_does_not_acknowledge_the_token_in_time_is_asked(
    tmp_path: Path, first: RequestOutcome, ended: list[RunOutcome]
) -> None:
    world = Carried(tmp_path)
    world.bridges.does |= {(300, Word.TOKEN): NOBODY, (300, Word.FETCH): first}
    world.offer()
    assert (300, Word.FETCH) not in world.asked(OFFER_S)
    world.go(2.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == ended
    assert len(world.facts(StepStarted)) == 1 - len(ended)


def test_a_run_of_which_no_bridge_knows_anything_is_aborted(tmp_path: Path) -> None:
    killed(tmp_path, Word.PART)
    world = again(tmp_path, {300: UNKNOWN, 301: told(), 302: UNKNOWN})
    world.go(2.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def is_off(world: Carried) -> None:
    world.bridges.off.add(300)


def is_silent(world: Carried) -> None:
    world.bridges.does[300, Word.FETCH] = NOBODY


def refuses(world: Carried) -> None:
    world.bridges.does[300, Word.FETCH] = FAILS


@pytest.mark.parametrize("change", [is_off, is_silent, refuses])
def test_a_run_whose_first_bridge_does_not_say_it_waits_and_can_be_aborted(
    tmp_path: Path, change: Callable[[Carried], None]
) -> None:
    run_id = killed(tmp_path)
    world = again(tmp_path, {301: told(), 302: told()})
    change(world)
    world.go(AWAY_S + 10)
    assert not ends(world), "it may have begun"
    assert world.carried.has(run_id)
    reason = world.reason()
    assert reason.startswith("c0: ")
    assert f"start c0, or abort it: ua-fleet scenario abort {run_id}" in reason
    assert "adopt" not in reason
    with pytest.raises(ScenarioError, match="is asking"):
        world.carried.adopt(run_id, "c0", (), "anna")
    with pytest.raises(ScenarioError, match="can be paused only while it is under way"):
        world.carried.pause(run_id, "anna")
    world.carried.abort(run_id, "enough", "anna")
    world.bridges.off.clear()
    world.go(2.0)
    assert set(ends(world)) == {"aborted"}
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_a_first_bridge_that_answers_late_has_the_run_followed(tmp_path: Path) -> None:
    killed(tmp_path)
    world = again(tmp_path, {300: told(active=("0",)), 301: told(), 302: told()})
    world.bridges.off.add(300)
    world.go(AWAY_S)
    world.journal.close()
    last = again(tmp_path, {300: told(active=("0",)), 301: told(), 302: told()})
    last.bridges.off.add(300)
    last.go(AWAY_S)
    assert not last.facts(StepStarted)
    last.bridges.off.clear()
    last.go(6.0)
    assert not ends(last)
    assert last.facts(StepStarted)
    assert last.reason() == ""


def test_a_first_bridge_that_is_not_in_the_file_keeps_the_run_waiting(tmp_path: Path) -> None:
    """The bridges are asked in the file of the next server alone: c2, with the last task, cannot be."""
    run_id = killed(tmp_path, Word.PART)
    world = Carried(tmp_path, 2)
    world.bridges.does |= {(300, Word.FETCH): UNKNOWN, (301, Word.FETCH): UNKNOWN}
    world.go(6.0)
    assert not ends(world), "c2 may know more"
    assert "space 302: it is not in fleet.yaml" in world.reason()
    world.carried.abort(run_id, "", "anna")
    world.go(1.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


@pytest.mark.parametrize("outcome", ["done", "failed"])
def test_a_bridge_that_had_nothing_to_do_proves_that_a_run_which_is_over_has_begun(
    tmp_path: Path, outcome: str
) -> None:
    killed(tmp_path)
    world = again(tmp_path, {301: told(closed=outcome), 302: told(closed=outcome)})
    world.bridges.off.add(300)
    world.go(2.0)
    assert not ends(world)
    assert len(world.facts(StepStarted)) == 1
    world.bridges.off.clear()
    world.bridges.does[300, Word.FETCH] = told(FACT, closed=outcome)
    world.go(6.0)
    assert [fact.outcome.value for fact in world.facts(RunEnded)] == [outcome]


def test_what_to_do_is_said_where_a_bridge_that_is_asked_has_left_the_file_and_another_one_has_waited_too_long(
    tmp_path: Path,
) -> None:
    run_id = killed(tmp_path)
    world = Carried(tmp_path, 2)
    world.bridges.does |= {(300, Word.FETCH): UNKNOWN, (301, Word.FETCH): told(closed="lost")}
    world.go(AWAY_S)
    assert not ends(world), "space 302 may know more"
    assert (
        "space 302: it is not in fleet.yaml any more, and whether the run has begun is not known: declare it again and"
        f" restart the server, or abort the run: ua-fleet scenario abort {run_id}" in world.reason()
    )
    world.carried.abort(run_id, "", "anna")
    world.go(1.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.ABORTED]


def test_that_one_bridge_has_waited_too_long_is_not_how_a_run_ends_that_another_one_has_begun(tmp_path: Path) -> None:
    killed(tmp_path)
    world = again(tmp_path, {301: told(closed="lost"), 302: told()})
    world.bridges.does[300, Word.FETCH] = None
    world.go(1.0)
    world.bridges.does[300, Word.FETCH] = told(active=("0",))
    world.go(6.0)
    assert world.facts(StepStarted)
    world.bridges.does |= {(space, Word.FETCH): told(FACT, closed="done") for space in (300, 301, 302)}
    world.go(6.0)
    assert [fact.outcome for fact in world.facts(RunEnded)] == [RunOutcome.DONE]


def test_why_the_first_bridge_has_refused_the_token_is_said(tmp_path: Path) -> None:
    world = Carried(tmp_path)
    world.bridges.does |= {(300, Word.TOKEN): FAILS, (300, Word.FETCH): told()}
    world.offer()
    world.go(OFFER_S + 3.0)
    (closing,) = world.facts(RunClosing)
    assert closing.reason == "nothing was begun, as its bridges say; c0 was to take the token: its disk fails"
    assert set(ends(world)) == {"aborted"}


@pytest.mark.parametrize("first", [UNKNOWN, told()], ids=["unknown", "known"])
@pytest.mark.parametrize("other", [UNKNOWN, told()], ids=["unknown", "known"])
def test_it_is_not_said_that_nothing_was_begun_where_the_first_bridge_knows_nothing_any_more(
    tmp_path: Path, first: RequestOutcome, other: RequestOutcome
) -> None:
    """It may have left the run out after an update, or have lost its file."""
    killed(tmp_path)
    world = again(tmp_path, {300: first, 301: UNKNOWN, 302: other})
    world.go(2.0)
    (closing,) = world.facts(RunClosing)
    assert closing.reason == {
        (True, True): "no bridge knows the run any more; see what its robots do",
        (True, False): "c0 does not know the run, and no other bridge has begun it; see what its robots do",
    }.get((first is UNKNOWN, other is UNKNOWN), "nothing was begun, as its bridges say")
