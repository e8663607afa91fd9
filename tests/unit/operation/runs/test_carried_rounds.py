"""A bridge is off that may have done rounds of a repetition alone: what a person names, and what its heir does."""

from __future__ import annotations

from collections.abc import Iterable
from hashlib import blake2b
from pathlib import Path

import pytest

from tests.unit.operation.runs.test_carried import AWAY_S, Carried, adopted_by, page
from ua_fleet.carrying.segment_scenario import segment_scenario
from ua_fleet.errors import ScenarioError
from ua_fleet.operation.runs.carried_adoption import DoneUnclear, RoundsUnknown
from ua_fleet.pubsub.carry_action import Word
from ua_fleet.scenario import Run
from ua_fleet.scenario.effects import WantRobot
from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    RunAdopted,
    StepEnded,
    StepState,
    TaskAnswered,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
    decode_fact,
    encode_fact,
)
from ua_fleet.values import StatusCode

FIRST = "  - {task: first, skill: work, robot: r0}"
LAST = "  - {task: last, skill: work, robot: r0}"
ZERO = "      - {task: zero, skill: work, robot: r0}"
TASK = "      - {task: one, skill: work, robot: r1}"
MORE = "      - {task: onemore, skill: work, robot: r1}"
SELDOM = """      - if: with_others
        then: [{task: two, skill: work, robot: r2}, {task: three, skill: work, robot: r0}]"""
INNER = "      - repeat: [{task: deep, skill: work, robot: r1}]\n        times: 9"
OTHERS = """  - repeat: [{task: four, skill: work, robot: r2}]
    times: 10000"""

UNDER_WAY = [
    encode_fact(IterationStarted(10.0, "1", 2)),
    encode_fact(TaskAssigned(10.0, "1.repeat.0@2", "one", 1, "r1", "ff" * 16, "work")),
]
"""What is heard of a round in whose midst the bridge went off."""


@pytest.fixture
def world(tmp_path: Path) -> Iterable[Carried]:
    made = Carried(tmp_path)
    yield made
    assert not made.mistakes.count, made.mistakes.text()


def repeated(*body: str, behind: str = "", times: int = 10_000) -> str:
    steps = "\n".join([FIRST, "  - repeat:", *body, f"    times: {times}", *([behind] if behind else []), LAST])
    return f"version: 1\nname: alone\nparameters: {{with_others: false}}\nsteps:\n{steps}\n"


def began(world: Carried, text: str, *heard: str, is_known: bool = False) -> str:
    """A run of which this was fetched of c1, which is off now; `is_known`: it has not told of more before it was."""
    world.bridges.does[301, Word.FETCH] = page(*heard)
    checked, found = world.carried.check(text)
    assert not checked.problems + found.problems
    run_id = world.carried.start(checked.scenario, (), (), "anna")
    world.go(11.0)
    if not is_known:
        world.tell_token(301, run_id, (1,), count=10_000)
    world.bridges.off.add(301)
    world.go(AWAY_S + 10)
    return run_id


def done(number: int, *keys: str) -> list[str]:
    """A round of the repetition, all of which was done by robots."""
    facts: list[Fact] = [IterationStarted(10.0, "1", number)]
    for place, key in enumerate(keys or ("1.repeat.0",)):
        step, name = f"{key}@{number}", ("one", "onemore")[place]
        execution_id = blake2b(step.encode(), digest_size=16).hexdigest()
        facts += [
            TaskAssigned(10.0, step, name, 1, "r1", execution_id, "work"),
            TaskOver(10.0, step, 1, TaskOutcome.DONE, Then.DONE, results={"out": float(number)}),
            StepEnded(10.0, step, StepState.DONE),
        ]
    return [encode_fact(fact) for fact in facts]


def heirs(world: Carried, heir: str) -> tuple[list[str], list[Fact]]:
    """What the heir of the one segment with facts wants robots for, and what it was told of it."""
    world.go(5.0)
    told = adopted_by(world, {"c0": 300, "c2": 302}[heir])
    ((place, lines),) = told.facts.items()
    segment, facts = told.part.segments[int(place)], [decode_fact(line) for line in lines]
    scenario, known = segment_scenario("made", segment.body), list[Fact]()
    Run.create("run", scenario, {}, known.append, by="x", now=0.0)
    run = Run.restore(scenario, [*known, *facts], lambda _fact: None)
    effects = [*run.again(lambda _name: 0.0, 99.0), *run.poll(lambda _name: 0.0, 99.0)]
    return [effect.step for effect in effects if isinstance(effect, WantRobot)], facts


def test_rounds_of_a_repetition_within_a_segment_have_to_be_named(world: Carried) -> None:
    run_id = began(world, repeated(TASK), *done(0), *done(1))
    for said in ((), ("one",)):
        with pytest.raises(RoundsUnknown, match="c1 may have done more rounds of one alone: round 1 was heard of last"):
            world.carried.adopt(run_id, "c1", said, "anna")
    assert not world.facts(RunAdopted)
    wanted, facts = heirs(world, world.carried.adopt(run_id, "c1", ("one@4711",), "anna"))
    assert wanted == ["1.repeat.0@4712"]
    last = StepEnded(facts[-1].at, "1.repeat.0@4711", StepState.DONE, "anna has said so")
    assert facts[-2:] == [IterationStarted(facts[-1].at, "1", 4711), last]
    assert [fact.results for fact in facts if isinstance(fact, TaskOver)] == [{}], "a result of a round before is none"


def test_a_repetition_within_a_segment_of_which_no_more_was_done_goes_on_with_the_round_that_was_heard(
    world: Carried,
) -> None:
    run_id = began(world, repeated(TASK), *done(0), *done(1))
    wanted, facts = heirs(world, world.carried.adopt(run_id, "c1", ("one@none",), "anna"))
    assert wanted == ["1.repeat.0@2"]
    assert [fact.results for fact in facts if isinstance(fact, TaskOver)] == [{"out": 1.0}]


@pytest.mark.parametrize("body", [[TASK], [TASK, SELDOM]], ids=["within a segment", "over segments"])
def test_a_bridge_all_of_which_was_fetched_may_have_gone_on_while_it_was_cut_off(
    world: Carried, body: list[str]
) -> None:
    """From the server: it goes on alone, or with tokens of others that the server does not hear of."""
    run_id = began(world, repeated(*body), *done(0), *done(1), *UNDER_WAY, is_known=True)
    for said in ((), ("one",)):
        with pytest.raises(RoundsUnknown, match="more rounds of one alone: round 2 was heard of last, and a"):
            world.carried.adopt(run_id, "c1", said, "anna")
    assert not world.facts(RunAdopted)
    assert world.carried.adopt(run_id, "c1", ("one@200",), "anna") in ("c0", "c2")


def test_a_task_of_a_repetition_that_was_under_way_begins_again_where_no_more_was_done(world: Carried) -> None:
    run_id = began(world, repeated(TASK), *done(0), *done(1), *UNDER_WAY, is_known=True)
    wanted, facts = heirs(world, world.carried.adopt(run_id, "c1", ("one@none",), "anna"))
    assert wanted == ["1.repeat.0@2"]
    assert isinstance(facts[-1], TaskAnswered)


def test_what_was_under_way_in_a_round_that_is_over_is_not_begun_again(world: Carried) -> None:
    heard = (*done(0), *done(1), *UNDER_WAY)
    run_id = began(world, repeated(TASK), *heard)
    with pytest.raises(RoundsUnknown):
        world.carried.adopt(run_id, "c1", ("one@0",), "anna")
    wanted, _ = heirs(world, world.carried.adopt(run_id, "c1", ("one@7",), "anna"))
    assert wanted == ["1.repeat.0@8"]


@pytest.mark.parametrize("body", [[TASK], [TASK, SELDOM]], ids=["within a segment", "over segments"])
def test_a_repetition_that_has_ended_is_not_asked_for(world: Carried, body: list[str]) -> None:
    ended = encode_fact(StepEnded(11.0, "1", StepState.DONE))
    run_id = began(world, repeated(*body, times=2), *done(0), *done(1), ended)
    assert world.carried.adopt(run_id, "c1", (), "anna") in ("c0", "c2")


@pytest.mark.parametrize("body", [[TASK], [TASK, SELDOM]], ids=["within a segment", "over segments"])
@pytest.mark.parametrize(
    "name", ["one@ROUND", "one@x", "one@-1", "one@4.2", "one@²", "one@", "one@1@2", "one@٣", "one@10000"]
)
def test_a_round_that_is_none_is_refused(world: Carried, body: list[str], name: str) -> None:
    run_id = began(world, repeated(*body))
    with pytest.raises(DoneUnclear) as refused:
        world.carried.adopt(run_id, "c1", (name,), "anna")
    assert refused.value.ua_status == StatusCode.BAD_INVALID_ARGUMENT
    assert ("one@ROUND" in str(refused.value)) or "the last one of that repeat is 9999" in str(refused.value)
    assert not world.facts(RunAdopted)


@pytest.mark.parametrize(("times", "name"), [(3, "one@3"), (10_000, "one@3"), (10_000, "one@41")])
def test_a_round_that_another_bridge_has_not_begun_is_refused(world: Carried, times: int, name: str) -> None:
    """The heir would wait for it for ever."""
    world.bridges.does[300, Word.FETCH] = page(*[encode_fact(IterationStarted(10.0, "1", each)) for each in range(3)])
    run_id = began(world, repeated(ZERO, TASK, times=times))
    with pytest.raises(DoneUnclear) as refused:
        world.carried.adopt(run_id, "c1", (name,), "anna")
    assert ("the last one of that repeat is 2," if times == 3 else "the last one that has is 2,") in str(refused.value)
    assert not world.facts(RunAdopted)
    assert world.carried.adopt(run_id, "c1", ("one@2",), "anna") in ("c0", "c2")


def test_no_round_is_done_where_another_bridge_has_begun_none(world: Carried) -> None:
    run_id = began(world, repeated(ZERO, TASK))
    with pytest.raises(DoneUnclear, match="that round of the repeat has not begun; none has, as"):
        world.carried.adopt(run_id, "c1", ("one@0",), "anna")


def test_a_round_within_another_one_that_another_bridge_has_not_begun_is_refused(world: Carried) -> None:
    inner = f"      - repeat:\n    {ZERO}\n    {TASK}\n        times: 9"
    begun = [("1", 0), ("1.repeat.0@0", 0), ("1.repeat.0@0", 8), ("1", 1), ("1.repeat.0@1", 2)]
    facts = [encode_fact(IterationStarted(10.0, step, number)) for step, number in begun]
    world.bridges.does[300, Word.FETCH] = page(*facts)
    run_id = began(world, repeated(inner))
    for name in ("one@1@3", "one@2@0"):
        with pytest.raises(DoneUnclear, match="that round of the repeat has not begun; the last one that has is 1"):
            world.carried.adopt(run_id, "c1", (name,), "anna")
    with pytest.raises(DoneUnclear, match="the last one of that repeat is 8"):
        world.carried.adopt(run_id, "c1", ("one@0@9",), "anna")
    assert world.carried.adopt(run_id, "c1", ("one@0@8", "one@1@2"), "anna") in ("c0", "c2")


def test_a_round_can_be_named_of_which_a_bridge_that_does_not_answer_may_know(world: Carried) -> None:
    run_id = began(world, repeated(ZERO, TASK, behind=OTHERS))
    world.bridges.off.add(300)
    world.go(6.0)
    assert world.carried.adopt(run_id, "c1", ("one@41",), "anna") == "c2"


def test_a_task_outside_a_repetition_and_one_of_another_bridge_have_no_rounds(world: Carried) -> None:
    behind = "  - {task: behind, skill: work, robot: r1}"
    run_id = began(world, repeated(TASK, SELDOM, behind=behind), is_known=True)
    for name in ("behind@none", "behind@0", "2@none"):
        with pytest.raises(DoneUnclear, match="is in no repeat; name it without a round: --done "):
            world.carried.adopt(run_id, "c1", (name,), "anna")
    for name in ("two@0", "two"):
        with pytest.raises(DoneUnclear, match=f"'{name}': the bridge that is off does no such task; it does `one`, "):
            world.carried.adopt(run_id, "c1", (name,), "anna")
    with pytest.raises(DoneUnclear, match="'behnd': the bridge that is off does no such task; did you mean `behind`"):
        world.carried.adopt(run_id, "c1", ("behnd",), "anna")
    assert world.carried.adopt(run_id, "c1", ("behind", "1.repeat.0@3"), "anna") in ("c0", "c2")


@pytest.mark.parametrize(
    ("body", "keys"),
    [([TASK, MORE], ("1.repeat.0", "1.repeat.1")), ([TASK, MORE, SELDOM], ("1.repeat.0", "1.repeat.1"))],
    ids=["within a segment", "over segments"],
)
def test_every_task_of_a_round_is_asked_for(world: Carried, body: list[str], keys: tuple[str, ...]) -> None:
    run_id = began(world, repeated(*body), *done(0, *keys), *done(1, *keys))
    with pytest.raises(RoundsUnknown) as refused:
        world.carried.adopt(run_id, "c1", (), "anna")
    said = str(refused.value)
    assert "c1 may have done more rounds of one and onemore alone: round 1 was heard of last" in said
    assert f"adopt {run_id} c1 --off --done one@ROUND --done onemore@ROUND;" in said
    assert said.endswith("--done one@none --done onemore@none")
    world.carried.adopt(run_id, "c1", ("one@41", "onemore@41"), "anna")
    world.go(5.0)
    (heir,) = [fact.heir for fact in world.facts(RunAdopted)]
    ((_, lines),) = adopted_by(world, heir).facts.items()
    ended = [fact.step for fact in map(decode_fact, lines) if isinstance(fact, StepEnded) and fact.step.endswith("@41")]
    assert ended == ["1.repeat.0@41", "1.repeat.1@41"]


def test_the_last_task_of_a_round_was_not_done_yet(world: Carried) -> None:
    run_id = began(world, repeated(TASK, MORE), *done(0, "1.repeat.0", "1.repeat.1"))
    wanted, _ = heirs(world, world.carried.adopt(run_id, "c1", ("one@41", "onemore@40"), "anna"))
    assert wanted == ["1.repeat.1@41"]


@pytest.mark.parametrize("body", [[TASK, INNER], [TASK, INNER, SELDOM]], ids=["within a segment", "over segments"])
def test_a_task_in_repetitions_within_each_other_is_named_with_a_number_for_each(
    world: Carried, body: list[str]
) -> None:
    inner = encode_fact(IterationStarted(10.0, "1.repeat.1@1", 7))
    run_id = began(world, repeated(*body), *done(0), *done(1), inner)
    with pytest.raises(RoundsUnknown, match="--off --done one@ROUND --done deep@OUTER@INNER;"):
        world.carried.adopt(run_id, "c1", (), "anna")
    for name in ("deep@41", "deep@2", "deep@1@x"):
        with pytest.raises(DoneUnclear, match="write --done deep@OUTER@INNER with"):
            world.carried.adopt(run_id, "c1", ("one@1", name), "anna")
    with pytest.raises(RoundsUnknown, match="rounds of deep alone: round 1@7 was heard of last"):
        world.carried.adopt(run_id, "c1", ("one@5", "deep@1@2"), "anna")
    world.carried.adopt(run_id, "c1", ("one@5", "deep@5@3"), "anna")
    world.go(5.0)
    (heir,) = [fact.heir for fact in world.facts(RunAdopted)]
    facts = [decode_fact(line) for lines in adopted_by(world, heir).facts.values() for line in lines]
    assert {fact.step for fact in facts if isinstance(fact, StepEnded) and "has said so" in fact.reason} == {
        "1.repeat.0@5",
        "1.repeat.1.repeat.0@5@3",
    }
    begun = [(fact.step, fact.number) for fact in facts if isinstance(fact, IterationStarted)]
    assert begun[-1] == ("1.repeat.1@5", 3)


def test_a_run_with_many_rounds_within_a_segment_can_be_adopted(world: Carried) -> None:
    heard = [line for number in range(900) for line in done(number)]
    run_id = began(world, repeated(TASK), *heard, is_known=True)
    wanted, facts = heirs(world, world.carried.adopt(run_id, "c1", ("one@none",), "anna"))
    assert wanted == ["1.repeat.0@900"]
    assert len(facts) < 10
    assert [fact.results for fact in facts if isinstance(fact, TaskOver)] == [{"out": 899.0}]


@pytest.mark.parametrize("body", [[TASK], [TASK, SELDOM]], ids=["within a segment", "over segments"])
def test_rounds_of_a_bridge_that_was_left_out_before_are_not_asked_for_again(tmp_path: Path, body: list[str]) -> None:
    world = Carried(tmp_path)
    run_id = began(world, repeated(*body, behind=OTHERS), *done(0), *done(1), is_known=True)
    world.bridges.does |= {(space, Word.ADOPT): None for space in (300, 302)}
    world.carried.adopt(run_id, "c1", ("one@none",), "anna")
    world.go(1.0)
    world.tell_token(302, run_id, (), count=50)
    world.bridges.off.add(302)
    world.go(AWAY_S + 10)
    with pytest.raises(RoundsUnknown, match=r"^c2 may have done more rounds of four alone: no round was heard of"):
        world.carried.adopt(run_id, "c2", (), "anna")
    assert world.carried.adopt(run_id, "c2", ("four@none",), "anna") == "c0"
    assert not world.mistakes.count, world.mistakes.text()


def test_rounds_that_two_bridges_have_done_that_are_both_off_are_asked_for(tmp_path: Path) -> None:
    both = "      - {task: two, skill: work, robot: r2}"
    world = Carried(tmp_path)
    run_id = began(world, repeated(TASK, both), *done(0))
    world.bridges.does |= {(space, Word.ADOPT): None for space in (300, 302)}
    world.carried.adopt(run_id, "c1", (), "anna")
    world.go(1.0)
    world.tell_token(302, run_id, (), count=50)
    world.bridges.off.add(302)
    world.go(AWAY_S + 10)
    with pytest.raises(ScenarioError, match=r"^c1 and c2 may have done more rounds of one and two alone: round 0 was"):
        world.carried.adopt(run_id, "c2", (), "anna")
    assert world.carried.adopt(run_id, "c2", ("one@6", "two@5"), "anna") == "c0"
    assert not world.mistakes.count, world.mistakes.text()
