"""What a bridge does when another one of its run is off, and when it was away itself: see `tests/carried`, too."""

from __future__ import annotations

from dataclasses import replace

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
    decode_adoption,
    encode_adoption,
    heir_of,
    plan_without,
)
from ua_fleet.carrying.facts import CarryFact, RunClosed, RunDoubted, decode_carry_fact, encode_carry_fact
from ua_fleet.carrying.holder import ADOPTED, AGAIN_S, LOST
from ua_fleet.carrying.part import PartInvalid
from ua_fleet.errors import StorageUnavailable
from ua_fleet.scenario.facts import (
    Fact,
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
    made = Adoption(parts(2, heir=space, gone=gone)[space], (gone,), "anna")
    return encode_adoption(replace(made, **other), encode_part(made.part))  # type: ignore[arg-type]


def token(segment: int, epoch: int = 1) -> bytes:
    made = parts(epoch)[300 if segment != 1 else 301]
    values = {"one.out": 2.0} if segment == 1 else {}
    return encode_token(Token("run", made.plan_hash, epoch, segment, 0, "", values), list(values))


def test_the_first_bridge_that_all_take_actions_of_is_the_heir() -> None:
    assert heir_of(PLAN, [301], VIEW) == 300
    assert heir_of(PLAN, [300], VIEW) == 301
    assert heir_of(PLAN, [301], replace(VIEW, requestors={})) == 300, "a bridge alone needs nobody"


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


def test_a_bridge_that_was_heard_again_is_off_once_more_where_somebody_says_so_again() -> None:
    """It is told after each restart what is off now, and not what was."""

    def off(holder: Holder) -> list[int]:
        return [one.space for one in holder.again(30.0) if isinstance(one, Gone)]

    bridge = Bridge(300)
    bridge.holder.take_adoption(adoption(300, 301), 20.0)
    assert off(bridge.again()) == [301]
    bridge.holder.bridge_returned(301, 21.0)
    assert off(bridge.again()) == []
    made = Adoption(parts(3, heir=300, gone=301)[300], (301,), "anna")
    bridge.holder.take_adoption(encode_adoption(made, encode_part(made.part)), 22.0)
    assert off(bridge.again())[-1:] == [301]


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
        bridge.holder.take_adoption(encode_adoption(Adoption(other, (300,), "anna"), encode_part(other)), 1.0)
    old = replace(parts()[301], plan_hash=bytes(8))
    with pytest.raises(RunRefused, match="epoch 1"):
        bridge.holder.take_adoption(encode_adoption(Adoption(old, (300,), "anna"), encode_part(old)), 1.0)
    for broken in (b"", b"x" * 50, b"x" * 40_000, adoption(301, 300)[:-5]):
        with pytest.raises(PartInvalid):
            bridge.holder.take_adoption(broken, 1.0)
    bridge.holder.take_end("run", "aborted", "enough", 0, 2.0)
    with pytest.raises(RunRefused, match="is over here"):
        bridge.holder.take_adoption(adoption(301, 300), 3.0)
    assert decode_adoption(adoption(301, 300)).gone == (300,)


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
    (stop,) = late.told_epoch(AskEpoch("run", 300), epoch, 51.0, left_out=True)
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


def three(epoch: int = 1) -> dict[int, Part]:
    """Three bridges do a task each; with the second epoch, the last one is off and the first one has its task."""
    made = plan(task("one", "a"), task("two", "b"), task("three", "c"))
    if epoch > 1:
        made = plan_without(made, 302, 300)
    return parts_of(made, "run", "made", {}, "anna", adopt_after_s=AWAY_S, epoch=epoch)


def second_epoch(space: int) -> bytes:
    part = three(2)[space]
    return encode_adoption(Adoption(part, (302,), "anna"), encode_part(part))


@pytest.mark.parametrize("was_away", [False, True])
def test_a_bridge_that_hears_of_an_epoch_before_its_part_comes_waits_for_that(*, was_away: bool) -> None:
    facts: list[CarryFact] = []
    behind, heir = Holder(301, facts.append), Holder(300, lambda _fact: None)
    behind.take_part(encode_part(three()[301]), 0.0)
    heir.take_part(encode_part(three()[300]), 0.0)
    heir.take_adoption(second_epoch(300), 20.0)
    behind.take_token(encode_token(Token("run", three()[301].plan_hash, 1, 1, 0), ()), 300, 1.0)
    if was_away:
        behind = Holder(301, facts.append, list(facts))
        assert behind.again(50.0) == []
    else:
        behind.segment_ended("run", SegmentRound(1), 2.0)
        (sent,) = behind.to_send()
        assert isinstance(sent, SendToken)
        behind.refused(sent)
    told = heir.asked_epoch(heir.runs["run"], 301)
    assert told == {"epoch": 2, "left_out": False}
    assert heir.asked_epoch(heir.runs["run"], 302)["left_out"]
    assert behind.told_epoch(AskEpoch("run", 300), now=51.0, **told) == []
    assert behind.runs["run"].closed is None
    assert bool(behind.in_doubt) is was_away, "a token of it may be on its way to another one still"

    effects = behind.take_adoption(second_epoch(301), 60.0)
    assert [type(one) for one in effects] == ([Gone, Begin] if was_away else [Gone])
    assert not behind.in_doubt
    behind.segment_ended("run", SegmentRound(1), 61.0)
    (sent,) = behind.to_send()
    assert isinstance(sent, SendToken)
    begun = heir.take_token(sent.content, 301, 62.0)
    assert [one.segment.number for one in begun if isinstance(one, Begin)] == [2], "it is taken with the new epoch"


ASSIGNED = TaskAssigned(1.0, "1", "two", 1, "b", "00" * 16, "work")


@pytest.mark.parametrize(
    ("facts", "done", "said"),
    [
        ([], ["two"], [StepEnded(9.0, "1", StepState.DONE, "anna has said so")]),
        ([], ["1"], [StepEnded(9.0, "1", StepState.DONE, "anna has said so")]),
        ([], ["1@2"], []),
        ([], ["two@none"], []),
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
        holder.told_epoch(asked, 2, 3.0, left_out=True)
    assert asked in list(holder.to_send())
    holder.told_epoch(asked, 2, 4.0, left_out=True)
    assert list(holder.to_send()) == []


def test_a_bridge_that_was_away_hears_that_the_run_is_over() -> None:
    bridge, other = Bridge(301), Bridge(300)
    bridge.holder.take_token(token(1), 300, 1.0)
    other.holder.take_end("run", "aborted", "enough", 0, 2.0)
    late = bridge.again()
    assert late.again(50.0) == []
    told = other.holder.asked_epoch(other.holder.runs["run"], 301)
    assert told == {"epoch": 1, "left_out": False, "outcome": "aborted", "reason": "enough"}
    (stop,) = late.told_epoch(AskEpoch("run", 300), told.pop("epoch"), 51.0, **told)
    assert stop == Stop("run", (SegmentRound(1),), "enough")
    for holder in (late, bridge.again()):
        closed = holder.runs["run"].closed
        assert closed is not None
        assert (closed.outcome, closed.reason, closed.by) == ("aborted", "enough", 300)
        assert list(holder.to_send()) == [], "who has ended it tells the others"


def test_a_bridge_that_was_left_out_itself_does_not_say_that_another_one_was_not() -> None:
    bridge, other = Bridge(301), Bridge(300)
    assert other.holder.asked_epoch(other.holder.runs["run"], 301) == {"epoch": 1, "left_out": False}
    late = other.again()
    late.again(50.0)
    late.told_epoch(AskEpoch("run", 301), 2, 51.0, left_out=True)
    with pytest.raises(RunRefused, match="is over here: adopted"):
        late.asked_epoch(late.runs["run"], 301)
    bridge.holder.take_token(token(1), 300, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(1), 2.0)
    (sent,) = bridge.holder.to_send()
    assert isinstance(sent, SendToken)
    bridge.holder.refused(sent)
    bridge.holder.take_adoption(adoption(301, 300), 20.0)
    assert list(bridge.holder.to_send()) == [], "it asks until it knows, and no longer"


@pytest.mark.parametrize(
    ("now", "is_other_boot", "asks"),
    [(1001.0, False, False), (1001.0, True, True), (30.0, False, True), (999.5, False, False), (8200.0, False, True)],
    ids=["away for a second", "clock of the shutdown", "clock of 1970", "clock set back by little", "away for long"],
)
def test_a_clock_that_began_anew_does_not_tell_how_long_a_bridge_was_away(
    now: float, *, is_other_boot: bool, asks: bool
) -> None:
    bridge = Bridge(301)
    bridge.holder.take_token(token(1), 300, 1000.0)
    again = bridge.again()
    begun = again.again(now, is_other_boot=is_other_boot)
    assert [type(one) for one in begun] == ([] if asks else [Begin])
    assert bool(again.in_doubt) == asks


def test_a_run_that_nobody_may_adopt_is_in_no_doubt_after_another_boot() -> None:
    facts = list[CarryFact]()
    holder = Holder(301, facts.append)
    holder.take_part(encode_part(replace(parts()[301], adopt_after_s=0.0)), 0.0)
    again = Holder(301, facts.append, facts)
    again.again(1.0, is_other_boot=True)
    assert not again.in_doubt
