"""What is adopted of a repetition: its rounds."""

from __future__ import annotations

from dataclasses import replace
from hashlib import blake2b
from typing import Any

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
    begun_places,
    begun_slots,
    encode_adoption,
    needed_places,
    plan_without,
    proved_over,
    results_heard,
)
from ua_fleet.carrying.facts import CarryFact
from ua_fleet.carrying.part import PartSegment
from ua_fleet.carrying.proof import heads_alone, needed_slots
from ua_fleet.endpoint.own_time import own_time
from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    StepEnded,
    StepStarted,
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


def test_of_tokens_of_others_those_are_sent_that_prove_something_and_results_that_are_handed_on() -> None:
    three = plan(task("one", "a"), task("two", "b"), task("three", "c", arguments={"x": "=one.out"}), task("four", "a"))
    gone = parts_of(three, "run", "made", {}, "anna")[301].segments
    assert [road.needs for one in gone.values() for road in one.then] == [("one.out",)]
    values = {"one.out": 1.0, "two.out": 2.0}
    filled = [FilledSlot(number, 0, "", values) for number in (0, 2, 3)]
    handed_on = {"one.out": 1.0}
    assert needed_slots(gone, filled) == [FilledSlot(number, 0, "", handed_on) for number in (0, 2, 3)]
    assert needed_slots(gone, [one._replace(values={}) for one in filled]) == [FilledSlot(2, 0, "", {})]


def test_what_tokens_of_others_prove_does_not_change_where_the_rest_is_not_sent() -> None:
    slots = [
        FilledSlot(number, 0, failed, {"one.out": float(round_number)}, (round_number,) * len(one.loops), one.loops)
        for number, one in enumerate(LOOP.segments)
        for round_number in (0, 1, 5)
        for failed in ("", "it broke")
    ]
    for gone in (300, 301, 302):
        needed = needed_slots(behind(gone), slots)
        assert len(needed) < len(slots)
        assert proved_over(behind(gone), needed) == proved_over(behind(gone), slots)


def test_what_is_adopted_of_many_rounds_takes_time_in_proportion() -> None:
    took: list[float] = []
    for count in (500, 4000):
        facts = rounds_of(count)
        began = own_time()
        adopted_places(behind(301)[TWO], facts, [f"two@{number}" for number in range(count)], 9.0, "anna")
        took.append(own_time() - began)
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


def test_the_newest_round_that_was_heard_of_a_bridge_proves_that_those_before_it_are_over() -> None:
    """It has done 3000 rounds alone, and forgotten all but the last: nobody else has a token since the first one."""
    one = LOOP.segments[ONE].steps[0].key
    gone, facts = behind(300), [fact for fact in rounds_of(3000) if getattr(fact, "step", "").endswith(("@0", "@2999"))]
    facts = [fact for fact in facts if isinstance(fact, StepEnded) and fact.step.startswith(one)]
    places = {
        place: tuple([encode_fact(fact) for fact in known])
        for number in (HEAD, ONE)
        for place, known in adopted_places(gone[number], facts, [], 9.0, "anna").items()
    }
    own = begun_places(gone, places)
    assert own == [FilledSlot(ONE, 0, "", {}, (2999,), (HEAD,))]
    last = SegmentRound(ONE, (2999,))
    assert needed_places(gone, places, own) == {str(last): places[last]}
    holder = Holder(301, list[CarryFact]().append)
    before = parts_of(LOOP, "run", "made", {}, "anna", adopt_after_s=AWAY_S)[301]
    made = parts_of(plan_without(LOOP, 300, 301), "run", "made", {}, "anna", adopt_after_s=AWAY_S, epoch=2)[301]
    holder.take_part(encode_part(before), 0.0)
    adoption = Adoption(made, (300,), "anna", tuple(own), {}, needed_places(gone, places, own))
    (begun,) = [
        one
        for one in holder.take_adoption(encode_adoption(adoption, encode_part(made)), 20.0)
        if isinstance(one, Begin)
    ]
    assert (begun.segment.number, begun.rounds, begun.facts) == (ONE, (2999,), places[last])


def test_a_person_names_the_last_round_alone() -> None:
    one = LOOP.segments[ONE].steps[0].key
    places = adopted_places(behind(300)[ONE], [], ["one@4711"], 9.0, "anna")
    assert places == {SegmentRound(ONE, (4711,)): [StepEnded(9.0, f"{one}@4711", StepState.DONE, "anna has said so")]}
    proved = proved_over(behind(300), begun_places(behind(300), places))
    assert proved.passed[ONE] == (4710,)
    assert proved.passed[HEAD] == (4711,)


def test_what_comes_after_a_repetition_gets_its_token_although_the_last_round_is_not_known() -> None:
    """The bridge had the repetition, and what comes after it: nobody else has that token."""
    alone = plan(
        {
            "repeat": [task("one", "a"), {"if": "one.out > 5", "then": [task("two", "b"), task("three", "c")]}],
            "times": 9,
        },
        task("after", "a"),
        task("last", "b"),
    )
    gone = dict(parts_of(alone, "run", "made", {}, "anna")[300].segments)
    (after,) = [number for number, one in gone.items() if "after" in [each.name for each in one.tasks()]]
    made = parts_of(plan_without(alone, 300, 301), "run", "made", {}, "anna", adopt_after_s=AWAY_S, epoch=2)[301]
    holder = Holder(301, list[CarryFact]().append)
    before = parts_of(alone, "run", "made", {}, "anna", adopt_after_s=AWAY_S)[301]
    holder.take_part(encode_part(before), 0.0)
    own = begun_places(gone, adopted_places(gone[after], [], ["after"], 9.0, "anna"))
    content = encode_adoption(Adoption(made, (300,), "anna", tuple(own)), encode_part(made))
    begun = [one for one in holder.take_adoption(content, 20.0) if isinstance(one, Begin)]
    assert [(one.segment.number, one.rounds) for one in begun] == [(after, ())]


def test_a_bridge_goes_round_alone_where_it_needs_no_token_of_another_one() -> None:
    def heads(space: int, *steps: dict[str, Any]) -> list[int]:
        return heads_alone(parts_of(plan(*steps), "run", "made", {}, "anna")[space].segments)

    seldom = {"if": "one.out > 5", "then": [task("two", "b"), task("three", "c")]}
    often = {"repeat": [task("one", "a"), seldom], "times": 9}
    assert len(heads(300, often)) == 1
    assert heads(301, often) == []
    assert heads(300, {"repeat": [task("one", "a"), task("two", "b")], "times": 9}) == []
    beside = {"parallel": [[task("four", "a")], [task("five", "b")]]}
    assert heads(300, {"repeat": [task("one", "a"), seldom, beside], "times": 9}) == [], "a join waits for another one"
    assert len(heads(300, {"repeat": [often], "times": 9})) == 2
    between = {"repeat": [often, task("six", "b")], "times": 9}
    assert len(heads(300, between)) == 1, "the inner one alone"


def test_the_newest_result_that_was_heard_counts_and_none_of_a_round_before_the_one_that_a_person_names() -> None:
    read = plan(
        {
            "repeat": [
                task("one", "a"),
                {"if": "one.out > 5", "then": [task("two", "b"), task("three", "c", arguments={"x": "=one.out"})]},
            ],
            "times": 9,
        },
        task("after", "a", arguments={"x": "=one.out"}),
        task("last", "b"),
    )
    gone = dict(parts_of(read, "run", "made", {}, "anna")[300].segments)
    (one,) = [each for each in gone.values() if "one" in [found.name for found in each.tasks()]]
    (after,) = [each for each in gone.values() if "after" in [found.name for found in each.tasks()]]
    step, name = f"{one.tasks()[0].key}@7", "one.out"
    heard: list[Fact] = [
        replace(ASSIGNED, step=step),
        TaskOver(3.0, step, 1, TaskOutcome.DONE, Then.DONE, results={"out": 7.0}),
        StepEnded(3.0, step, StepState.DONE),
    ]
    places = adopted_places(one, heard, [], 9.0, "anna")
    assert results_heard(gone, places, {name: 7.0}) == {name: 7.0}
    places = adopted_places(one, heard, ["one@8"], 9.0, "anna")
    assert results_heard(gone, places, {name: 7.0, "two.out": 1.0}) == {"two.out": 1.0}
    assert name in after.needs[0]
    own = begun_places(gone, adopted_places(after, [], ["after"], 9.0, "anna"), {name: 7.0})
    assert own == [FilledSlot(after.number, 0, "", {name: 7.0}, (), ())]


def test_the_first_fact_of_a_segment_is_of_no_step() -> None:
    assert begun_slots([behind(300)[ONE]], [StepStarted(1.0, "@7")]) == []
