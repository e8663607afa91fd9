"""What is adopted of a repetition: its rounds."""

from __future__ import annotations

import time
from dataclasses import replace
from hashlib import blake2b

from tests.unit.carrying.test_adoption import ASSIGNED, AWAY_S, parts
from tests.unit.carrying.test_plan import plan, task
from ua_fleet.carrying import (
    Begin,
    Holder,
    SegmentRound,
    Token,
    encode_part,
    encode_token,
    parts_of,
)
from ua_fleet.carrying.adoption import (
    Adoption,
    FilledSlot,
    adopted_places,
    begun_slots,
    encode_adoption,
    needed_places,
    plan_without,
    proved_over,
)
from ua_fleet.carrying.facts import CarryFact
from ua_fleet.carrying.part import PartSegment
from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    StepEnded,
    StepState,
    TaskAnswered,
    TaskOutcome,
    TaskOver,
    Then,
    encode_fact,
)

LOOP = plan(
    task("first", "a"),
    {
        "repeat": [task("one", "a"), {"if": "one.out > 5", "then": [task("two", "b")], "else": [task("three", "c")]}],
        "times": 9,
    },
    task("last", "b"),
)
HEAD, ONE, TWO, THREE = (number for number, one in enumerate(LOOP.segments) if one.loops)
LAST = LOOP.last


def behind(gone: int) -> dict[int, PartSegment]:
    return dict(parts_of(LOOP, "run", "made", {}, "anna")[gone].segments)


def test_a_token_of_a_round_proves_that_the_rounds_before_it_are_over() -> None:
    proved = proved_over(behind(301), [FilledSlot(HEAD, 0, "", {}, (5,), (HEAD,))])
    assert proved.passed == {TWO: (4,)}
    assert proved.over.keys() == {SegmentRound(TWO, (4,))}, "whether it was begun in that round, or is not to be"
    proved = proved_over(behind(300), [FilledSlot(THREE, 0, "", {}, (5,), (HEAD,))])
    assert proved.passed == {0: (), HEAD: (5,), ONE: (5,)}
    assert proved.over == {
        SegmentRound(0): ("", True),
        SegmentRound(HEAD, (5,)): ("", True),
        SegmentRound(ONE, (5,)): ("", False),
    }
    proved = proved_over(behind(300), [FilledSlot(LAST, 0, "", {})])
    assert proved.passed == {0: (), HEAD: ()}, "what comes after a repetition proves that it begins no further round"


def test_the_heir_begins_nothing_of_the_rounds_before() -> None:
    made = parts_of(plan_without(LOOP, 301, 300), "run", "made", {}, "anna", adopt_after_s=AWAY_S, epoch=2)[300]
    before = parts_of(LOOP, "run", "made", {}, "anna", adopt_after_s=AWAY_S)[300]
    holder = Holder(300, list[CarryFact]().append)
    holder.take_part(encode_part(before), 0.0)
    for segment, rounds in ((0, ()), (HEAD, (5,))):
        holder.take_token(encode_token(Token("run", before.plan_hash, 1, segment, 0, rounds=rounds), ()), 0, 1.0)
    holder.take_adoption(encode_adoption(Adoption(made, (301,), "anna"), encode_part(made)), 20.0)
    held = holder.runs["run"]
    assert [held.is_known(SegmentRound(TWO, (number,))) for number in (3, 4, 5, 6)] == [True, True, False, False]
    old = Token("run", made.plan_hash, 2, TWO, 0, "", {}, (3,))
    assert holder.take_token(encode_token(old, ()), 300, 21.0) == []
    new = Token("run", made.plan_hash, 2, TWO, 0, "", {}, (5,))
    assert [type(one) for one in holder.take_token(encode_token(new, ()), 300, 22.0)] == [Begin]


def test_what_was_heard_is_adopted_by_rounds() -> None:
    step = next(iter(behind(301)[TWO].body.steps)).key
    heard: list[Fact] = [
        replace(ASSIGNED, step=f"{step}@0"),
        TaskOver(3.0, f"{step}@0", 1, TaskOutcome.DONE, Then.DONE),
        replace(ASSIGNED, step=f"{step}@2"),
    ]
    found = adopted_places(behind(301)[TWO], heard, [f"{step}@1"], 9.0, "anna")
    assert found == {
        SegmentRound(TWO, (0,)): heard[:2],
        SegmentRound(TWO, (1,)): [StepEnded(9.0, f"{step}@1", StepState.DONE, "anna has said so")],
        SegmentRound(TWO, (2,)): [heard[2], TaskAnswered(9.0, f"{step}@2", Then.RETRY, "anna")],
    }
    by_name = adopted_places(behind(301)[TWO], heard, ["two"], 9.0, "anna")
    assert by_name[SegmentRound(TWO, (2,))][-1] == TaskAnswered(9.0, f"{step}@2", Then.DONE, "anna"), (
        "the last round is meant"
    )
    assert by_name[SegmentRound(TWO, (0,))] == heard[:2]


def rounds_of(count: int) -> list[Fact]:
    """What is heard of the bridges when `two` is under way in the last one of so many rounds."""
    one, two, head = (LOOP.segments[number].steps[0].key for number in (ONE, TWO, HEAD))
    facts: list[Fact] = []
    for number in range(count):
        facts.append(IterationStarted(1.0, head, number))
        for key in (one, two):
            step, is_last = f"{key}@{number}", (key, number) == (two, count - 1)
            facts.append(replace(ASSIGNED, step=step, execution_id=blake2b(step.encode(), digest_size=16).hexdigest()))
            ended: list[Fact] = [
                TaskOver(3.0, step, 1, TaskOutcome.DONE, Then.DONE),
                StepEnded(3.0, step, StepState.DONE),
            ]
            facts += [] if is_last else ended
    return facts


def test_rounds_that_the_heir_knows_to_be_over_are_not_sent_however_many() -> None:
    facts = rounds_of(3000)
    places = adopted_places(behind(301)[TWO], facts, [], 9.0, "anna")
    assert len(places) == 3000
    lines = {place: tuple([encode_fact(fact) for fact in known]) for place, known in places.items()}
    begun = begun_slots([behind(300)[number] for number in (HEAD, ONE)], facts)
    assert begun == [
        FilledSlot(HEAD, 0, "", {}, (2999,), (HEAD,)),
        FilledSlot(ONE, 0, "", {}, (2999,), (HEAD,)),
    ]
    needed = needed_places(behind(301), lines, begun)
    last = SegmentRound(TWO, (2999,))
    assert needed == {str(last): lines[last]}
    assert TaskAnswered(9.0, f"{LOOP.segments[TWO].steps[0].key}@2999", Then.RETRY, "anna") in places[last]
    made = replace(Adoption(parts(2, heir=300, gone=301)[300], (301,), "anna"), facts=needed)
    assert len(encode_adoption(made, encode_part(made.part))) < 2000


def test_rounds_of_which_nobody_else_has_a_token_are_sent() -> None:
    places = {SegmentRound(TWO, (number,)): ("line",) for number in range(6)}
    filled = [FilledSlot(HEAD, 0, "", {}, (3,), (HEAD,))]
    assert needed_places(behind(301), places, filled).keys() == {str(SegmentRound(TWO, (n,))) for n in (3, 4, 5)}
    assert needed_places(behind(301), places, []).keys() == {str(place) for place in places}


def test_what_is_adopted_of_many_rounds_takes_time_in_proportion() -> None:
    took: list[float] = []
    for count in (500, 4000):
        facts = rounds_of(count)
        began = time.process_time()
        adopted_places(behind(301)[TWO], facts, [f"two@{number}" for number in range(count)], 9.0, "anna")
        took.append(time.process_time() - began)
    assert took[1] < 8 * 3 * took[0], took


def test_what_the_head_of_a_repetition_has_decided_is_adopted() -> None:
    key = LOOP.segments[HEAD].steps[0].key
    heard: list[Fact] = [
        IterationStarted(1.0, key, 0),
        IterationStarted(2.0, key, 1),
        StepEnded(3.0, key, StepState.DONE),
    ]
    assert adopted_places(behind(300)[HEAD], heard, [], 9.0, "anna") == {
        SegmentRound(HEAD, (number,)): [fact] for number, fact in enumerate(heard)
    }
