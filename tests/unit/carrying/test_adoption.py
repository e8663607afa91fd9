"""What a bridge does when another one of its run is off, and when it was away itself: see `tests/carried`, too."""

from __future__ import annotations

import time
from dataclasses import replace
from hashlib import blake2b

import pytest

from tests.unit.carrying.test_plan import VIEW, plan, task
from ua_fleet.carrying import (
    AskEpoch,
    Begin,
    Gone,
    Holder,
    Part,
    RunRefused,
    SegmentRound,
    SendToken,
    Stop,
    Token,
    encode_part,
    encode_token,
    parts_of,
)
from ua_fleet.carrying.adoption import (
    Adoption,
    FilledSlot,
    adopted_facts,
    adopted_places,
    begun_slots,
    decode_adoption,
    encode_adoption,
    heir_of,
    needed_places,
    plan_without,
    proved_over,
)
from ua_fleet.carrying.facts import CarryFact, RunClosed, RunDoubted, decode_carry_fact, encode_carry_fact
from ua_fleet.carrying.holder import ADOPTED, AGAIN_S, LOST
from ua_fleet.carrying.part import PartInvalid, PartSegment
from ua_fleet.errors import StorageUnavailable
from ua_fleet.scenario.facts import (
    Fact,
    IterationStarted,
    StepEnded,
    StepState,
    TaskAccepted,
    TaskAnswered,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
    encode_fact,
)

PLAN = plan(task("one", "a"), task("two", "b", arguments={"x": "=one.out"}), task("three", "a"))
AWAY_S = 10.0


def parts(epoch: int = 1, *, heir: int = 0, gone: int = 0) -> dict[int, Part]:
    of_plan = plan_without(PLAN, gone, heir) if heir else PLAN
    return parts_of(of_plan, "run", "made", {}, "anna", adopt_after_s=AWAY_S, epoch=epoch)


class Bridge:
    """A holder with its journal, which has its part."""

    def __init__(self, space: int) -> None:
        self.space, self.facts = space, list[CarryFact]()
        self.holder = Holder(space, self.facts.append)
        self.holder.take_part(encode_part(parts()[space]), 0.0)

    def again(self) -> Holder:
        """The holder of the next process."""
        return Holder(self.space, self.facts.append, [decode_carry_fact(encode_carry_fact(one)) for one in self.facts])


def adoption(space: int, gone: int, **other: object) -> bytes:
    made = Adoption(parts(2, heir=space, gone=gone)[space], gone, "anna")
    return encode_adoption(replace(made, **other), encode_part(made.part))  # type: ignore[arg-type]


def token(segment: int, epoch: int = 1) -> bytes:
    made = parts(epoch)[300 if segment != 1 else 301]
    values = {"one.out": 2.0} if segment == 1 else {}
    return encode_token(Token("run", made.plan_hash, epoch, segment, 0, "", values), list(values))


def test_the_first_bridge_that_all_take_actions_of_is_the_heir() -> None:
    assert heir_of(PLAN, 301, VIEW) == 300
    assert heir_of(PLAN, 300, VIEW) == 301
    assert heir_of(PLAN, 301, replace(VIEW, requestors={})) == 300, "a bridge alone needs nobody"


def test_the_heir_goes_on_from_its_own_results_and_what_was_heard() -> None:
    bridge = Bridge(300)
    bridge.holder.take_token(token(0), 0, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(0), 2.0, results={"one.out": 5.0})
    (sent,) = bridge.holder.to_send()
    assert isinstance(sent, SendToken)
    bridge.holder.handed_over(sent, 3.0)
    lines = {"1": (encode_fact(StepEnded(2.5, "1", StepState.DONE)),)}
    gone, begun = bridge.holder.take_adoption(adoption(300, 301, facts=lines), 20.0)
    assert gone == Gone("run", 301, "anna")
    assert isinstance(begun, Begin)
    assert (begun.segment.number, begun.values, begun.facts) == (1, {"one.out": 5.0}, lines["1"])
    assert bridge.holder.take_adoption(adoption(300, 301, facts=lines), 21.0) == []
    again = [one for one in bridge.again().again(22.0) if isinstance(one, Begin)]
    assert [(one.segment.number, one.values, one.facts) for one in again] == [(1, {"one.out": 5.0}, lines["1"])]
    assert list(bridge.again().to_send()) == []


def test_a_token_that_another_bridge_has_proves_that_its_segment_is_over() -> None:
    bridge = Bridge(301)
    bridge.holder.take_token(token(1), 300, 1.0)
    effects = bridge.holder.take_adoption(adoption(301, 300), 20.0)
    assert [one.segment.number for one in effects if isinstance(one, Begin)] == [1], "and not the first one"
    filled = bridge.holder.runs["run"].filled()
    assert FilledSlot(1, 0, "", {"one.out": 2.0}) in filled


def test_the_first_segment_begins_at_the_heir_where_nobody_has_a_token_of_it() -> None:
    bridge = Bridge(301)
    effects = bridge.holder.take_adoption(adoption(301, 300), 20.0)
    assert [one.segment.number for one in effects if isinstance(one, Begin)] == [0]


def test_tokens_of_the_epoch_before_are_refused_and_said() -> None:
    bridge = Bridge(301)
    bridge.holder.take_adoption(adoption(301, 300), 20.0)
    with pytest.raises(RunRefused, match="epoch 1, and run run has 2"):
        bridge.holder.take_token(token(1), 300, 21.0)
    assert bridge.holder.runs["run"].stale == "space 300 has sent a token of epoch 1, and epoch 2 counts"


def test_an_adoption_of_another_run_or_plan_or_of_one_that_is_over_is_refused() -> None:
    bridge = Bridge(301)
    other = replace(parts(2, heir=301, gone=300)[301], run_id="other")
    with pytest.raises(RunRefused, match="no part of run other"):
        bridge.holder.take_adoption(encode_adoption(Adoption(other, 300, "anna"), encode_part(other)), 1.0)
    old = replace(parts()[301], plan_hash=bytes(8))
    with pytest.raises(RunRefused, match="epoch 1"):
        bridge.holder.take_adoption(encode_adoption(Adoption(old, 300, "anna"), encode_part(old)), 1.0)
    for broken in (b"", b"x" * 50, b"x" * 40_000, adoption(301, 300)[:-5]):
        with pytest.raises(PartInvalid):
            bridge.holder.take_adoption(broken, 1.0)
    bridge.holder.take_end("run", "aborted", "enough", 0, 2.0)
    with pytest.raises(RunRefused, match="is over here"):
        bridge.holder.take_adoption(adoption(301, 300), 3.0)
    assert decode_adoption(adoption(301, 300)).gone == 300


def test_a_bridge_that_was_away_begins_nothing_before_it_has_asked() -> None:
    bridge = Bridge(301)
    bridge.holder.take_token(token(1), 300, 1.0)
    soon = bridge.again()
    assert [type(one) for one in soon.again(1.0 + AWAY_S - 1)] == [Begin]
    late = bridge.again()
    assert late.again(1.0 + AWAY_S) == []
    assert list(late.to_send()) == [AskEpoch("run", 300)]
    assert [type(one) for one in late.told_epoch(AskEpoch("run", 300), 1, 20.0)] == [Begin]
    assert list(late.to_send()) == []


def test_a_token_that_comes_while_a_bridge_asks_waits() -> None:
    bridge = Bridge(301)
    late = bridge.again()
    assert late.again(50.0) == []
    assert late.take_token(token(1), 300, 51.0) == []
    assert [type(one) for one in late.told_epoch(AskEpoch("run", 300), 1, 52.0)] == [Begin]


def test_what_comes_while_a_bridge_asks_does_not_end_its_doubt_also_after_another_restart() -> None:
    bridge = Bridge(301)
    assert bridge.again().again(50.0) == []
    late = bridge.again()
    assert late.again(51.0) == []
    late.take_pause("run", False, "anna", 51.5)
    late.take_token(token(1), 300, 52.0)
    third = bridge.again()
    assert third.again(53.0) == []
    assert list(third.to_send()) == [AskEpoch("run", 300)]
    assert [type(one) for one in third.told_epoch(AskEpoch("run", 300), 1, 54.0)] == [Begin]
    assert [type(one) for one in bridge.again().again(55.0)] == [Begin]


@pytest.mark.parametrize(("epoch", "outcome"), [(2, ADOPTED), (None, LOST)])
def test_a_late_bridge_parks_what_it_has(epoch: int | None, outcome: str) -> None:
    bridge = Bridge(301)
    bridge.holder.take_token(token(1), 300, 1.0)
    late = bridge.again()
    late.again(50.0)
    (stop,) = late.told_epoch(AskEpoch("run", 300), epoch, 51.0)
    assert isinstance(stop, Stop)
    assert stop.places == (SegmentRound(1),)
    closed = bridge.facts[-1]
    assert isinstance(closed, RunClosed)
    assert closed.outcome == outcome
    assert list(late.to_send()) == [], "it tells nobody that the run is over"


def test_a_bridge_whose_token_is_refused_asks_why() -> None:
    bridge = Bridge(300)
    bridge.holder.take_token(token(0), 0, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(0), 2.0, results={"one.out": 5.0})
    (sent,) = bridge.holder.to_send()
    assert isinstance(sent, SendToken)
    bridge.holder.refused(sent)
    assert AskEpoch("run", 301) in list(bridge.holder.to_send())
    assert bridge.holder.told_epoch(AskEpoch("run", 301), 1, 3.0) == []
    assert list(bridge.holder.to_send()) == [sent]


ASSIGNED = TaskAssigned(1.0, "1", "two", 1, "b", "00" * 16, "work")


@pytest.mark.parametrize(
    ("facts", "done", "said"),
    [
        ([], ["two"], [StepEnded(9.0, "1", StepState.DONE, "anna has said so")]),
        ([], ["1@2"], [StepEnded(9.0, "1@2", StepState.DONE, "anna has said so")]),
        ([], ["one"], []),
        ([ASSIGNED], [], [TaskAnswered(9.0, "1", Then.RETRY, "anna")]),
        ([ASSIGNED, TaskAccepted(2.0, "1", 1)], ["two"], [TaskAnswered(9.0, "1", Then.DONE, "anna")]),
        ([ASSIGNED, TaskOver(3.0, "1", 1, TaskOutcome.DONE, Then.DONE), StepEnded(3.0, "1", StepState.DONE)], [], []),
    ],
)
def test_what_a_person_says_of_tasks_goes_before_what_was_heard(
    facts: list[Fact], done: list[str], said: list[Fact]
) -> None:
    steps = PLAN.segments[1].steps
    heard = [*facts, TaskAccepted(1.0, "0", 1)]
    assert adopted_facts(steps, heard, done, 9.0, "anna") == facts + said


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
    holder.take_adoption(encode_adoption(Adoption(made, 301, "anna"), encode_part(made)), 20.0)
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
    made = replace(Adoption(parts(2, heir=300, gone=301)[300], 301, "anna"), facts=needed)
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


def test_a_doubt_whose_end_could_not_be_written_goes_on_until_it_is() -> None:
    bridge = Bridge(301)
    bridge.holder.take_token(token(1), 300, 1.0)
    refused = [RunDoubted(0.0, "run", False)]

    def write(fact: CarryFact) -> None:
        if refused and isinstance(fact, RunDoubted) and fact.is_doubted == refused[0].is_doubted:
            refused.clear()
            raise StorageUnavailable("the disk is full")
        bridge.facts.append(fact)

    late = Holder(301, write, list(bridge.facts))
    late.again(50.0)
    asked = AskEpoch("run", 300)
    with pytest.raises(StorageUnavailable):
        late.told_epoch(asked, 1, 51.0)
    assert late.next_deadline() == 51.0 + AGAIN_S
    assert late.poll(52.0) == [], "it is not known to the disk yet"
    assert list(late.to_send()) == [asked]
    assert [type(one) for one in late.told_epoch(asked, 1, 53.0)] == [Begin]
    assert [type(one) for one in bridge.again().again(54.0)] == [Begin]


def test_a_bridge_that_cannot_write_that_it_was_adopted_asks_again() -> None:
    bridge = Bridge(300)
    bridge.holder.take_token(token(0), 0, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(0), 2.0, results={"one.out": 5.0})
    refused = [RunClosed]

    def write(fact: CarryFact) -> None:
        if refused and isinstance(fact, refused[0]):
            refused.clear()
            raise StorageUnavailable("the disk is full")

    holder = Holder(300, write, list(bridge.facts))
    (sent,) = holder.to_send()
    assert isinstance(sent, SendToken)
    holder.refused(sent)
    asked = AskEpoch("run", 301)
    with pytest.raises(StorageUnavailable):
        holder.told_epoch(asked, 2, 3.0)
    assert asked in list(holder.to_send())
    holder.told_epoch(asked, 2, 4.0)
    assert list(holder.to_send()) == []


def test_a_bridge_that_was_away_hears_that_the_run_is_over() -> None:
    bridge, other = Bridge(301), Bridge(300)
    bridge.holder.take_token(token(1), 300, 1.0)
    other.holder.take_end("run", "aborted", "enough", 0, 2.0)
    late = bridge.again()
    assert late.again(50.0) == []
    told = other.holder.asked_epoch(other.holder.runs["run"])
    assert told == {"epoch": 1, "outcome": "aborted", "reason": "enough"}
    (stop,) = late.told_epoch(AskEpoch("run", 300), told.pop("epoch"), 51.0, **told)
    assert stop == Stop("run", (SegmentRound(1),), "enough")
    for holder in (late, bridge.again()):
        closed = holder.runs["run"].closed
        assert closed is not None
        assert (closed.outcome, closed.reason, closed.by) == ("aborted", "enough", 300)
        assert list(holder.to_send()) == [], "who has ended it tells the others"


def test_a_bridge_that_was_left_out_itself_does_not_say_that_another_one_was_not() -> None:
    bridge, other = Bridge(301), Bridge(300)
    assert other.holder.asked_epoch(other.holder.runs["run"]) == {"epoch": 1}
    late = other.again()
    late.again(50.0)
    late.told_epoch(AskEpoch("run", 301), 2, 51.0)
    with pytest.raises(RunRefused, match="is over here: adopted"):
        late.asked_epoch(late.runs["run"])
    bridge.holder.take_token(token(1), 300, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(1), 2.0)
    (sent,) = bridge.holder.to_send()
    assert isinstance(sent, SendToken)
    bridge.holder.refused(sent)
    bridge.holder.take_adoption(adoption(301, 300), 20.0)
    assert list(bridge.holder.to_send()) == [], "it asks until it knows, and no longer"
