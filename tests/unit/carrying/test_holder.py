"""What a bridge does with parts, tokens and ends that are wrong or late; `tests/carried` has whole runs."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.unit.carrying.test_plan import plan, task
from ua_fleet.carrying import (
    Begin,
    Holder,
    Part,
    Pause,
    RunRefused,
    SegmentRound,
    SendEnd,
    SendToken,
    Stop,
    Token,
    encode_part,
    encode_token,
    parts_of,
)
from ua_fleet.carrying.facts import (
    CarryFact,
    EndTold,
    decode_carry_fact,
    encode_carry_fact,
)
from ua_fleet.carrying.holder import LOST, MOST_UNFETCHED
from ua_fleet.carrying.part import PartInvalid
from ua_fleet.carrying.token import TokenInvalid
from ua_fleet.carrying.words import decode_words, encode_words

PLAN = plan(task("one", "a"), task("two", "b", arguments={"x": "=one.out"}), task("three", "a"))


class Bridge:
    """A holder with its journal."""

    def __init__(self, space: int = 301, run_id: str = "run") -> None:
        self.facts: list[CarryFact] = []
        self.parts: dict[int, Part] = parts_of(PLAN, run_id, "made", {}, "anna")
        self.space = space
        self.holder = Holder(space, self.facts.append)

    def take_part(self) -> None:
        self.holder.take_part(encode_part(self.parts[self.space]), 0.0)

    def token(self, segment: int = 1, **other: object) -> bytes:
        token = Token("run", self.parts[301].plan_hash, 1, segment, 0, "", {"one.out": 2.0} if segment == 1 else {})
        return encode_token(replace(token, **other), ["one.out"] if segment == 1 else [])  # type: ignore[arg-type]

    def again(self) -> Holder:
        """The holder of the next process, with the journal as it is on the disk."""
        return Holder(self.space, self.facts.append, [decode_carry_fact(encode_carry_fact(one)) for one in self.facts])


@pytest.fixture
def bridge() -> Bridge:
    made = Bridge()
    made.take_part()
    return made


def test_a_token_begins_its_segment_once_however_often_it_comes(bridge: Bridge) -> None:
    (begun,) = bridge.holder.take_token(bridge.token(), 300, 1.0)
    assert isinstance(begun, Begin)
    assert begun.values == {"one.out": 2.0}
    assert bridge.holder.take_token(bridge.token(), 300, 2.0) == []
    assert bridge.again().take_token(bridge.token(), 300, 3.0) == []
    assert [one.segment.number for one in bridge.again().again(4.0) if isinstance(one, Begin)] == [1]


@pytest.mark.parametrize(
    ("change", "sender", "error", "said"),
    [
        ({"run_id": "other"}, 300, RunRefused, "no part of run other"),
        ({"plan_hash": bytes(8)}, 300, RunRefused, "another plan"),
        ({"epoch": 2}, 300, RunRefused, "epoch 2, and run run has 1"),
        ({}, 999, RunRefused, "space 999 is not in run run"),
        ({"slot": 3}, 300, TokenInvalid, "has no slot 3"),
        ({"slot": 255}, 300, TokenInvalid, "why the segment has failed"),
        ({"segment": 0}, 300, TokenInvalid, "not of this bridge"),
    ],
)
def test_a_token_that_is_not_for_this_run_here_is_refused(
    bridge: Bridge, change: dict[str, object], sender: int, error: type[Exception], said: str
) -> None:
    with pytest.raises(error, match=said):
        bridge.holder.take_token(bridge.token(**change), sender, 1.0)  # type: ignore[arg-type]
    assert len(bridge.facts) == 1


def test_a_second_token_that_says_something_else_is_refused(bridge: Bridge) -> None:
    bridge.holder.take_token(bridge.token(), 300, 1.0)
    with pytest.raises(TokenInvalid, match="another token there"):
        bridge.holder.take_token(bridge.token(values={"one.out": 3.0}), 300, 1.0)


def test_a_token_of_a_run_that_is_over_is_refused_also_after_a_restart(bridge: Bridge) -> None:
    bridge.holder.take_end("run", "aborted", "enough", 0, 1.0)
    for holder in (bridge.holder, bridge.again()):
        with pytest.raises(RunRefused, match="run run is over here: aborted, enough"):
            holder.take_token(bridge.token(), 300, 2.0)


def test_a_part_that_comes_after_the_end_begins_nothing() -> None:
    bridge = Bridge()
    bridge.holder.take_end("run", "aborted", "enough", 0, 1.0)
    for holder in (bridge.holder, bridge.again()):
        with pytest.raises(RunRefused, match="is over here"):
            holder.take_part(encode_part(bridge.parts[301]), 2.0)


def test_parts_that_do_not_fit_are_refused(bridge: Bridge) -> None:
    bridge.take_part()
    other = replace(bridge.parts[301], plan_hash=bytes(8))
    with pytest.raises(RunRefused, match="another plan here"):
        bridge.holder.take_part(encode_part(other), 1.0)
    with pytest.raises(PartInvalid, match="not for space 999"):
        Holder(999, bridge.facts.append).take_part(encode_part(bridge.parts[301]), 1.0)
    assert len(bridge.facts) == 1


def test_a_token_is_sent_until_it_is_acknowledged(bridge: Bridge) -> None:
    bridge.holder.take_token(bridge.token(), 300, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(1), 2.0, results={"two.out": 5.0})
    (sent,) = bridge.holder.to_send()
    assert isinstance(sent, SendToken)
    assert (sent.road.space, sent.road.segment) == (300, 2)
    assert list(bridge.again().to_send()) == [sent]
    bridge.holder.handed_over(sent, 3.0)
    assert list(bridge.holder.to_send()) == list(bridge.again().to_send()) == []


def test_a_segment_that_fails_fails_the_run_without_the_steps_between(bridge: Bridge) -> None:
    bridge.holder.take_token(bridge.token(), 300, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(1), 2.0, failed="no part there")
    (sent,) = bridge.holder.to_send()
    assert isinstance(sent, SendToken)
    last = Bridge(300)
    last.take_part()
    assert last.holder.take_token(sent.content, 301, 3.0) == []
    closed = last.holder.runs["run"].closed
    assert closed is not None
    assert (closed.outcome, closed.reason) == ("failed", "no part there")
    (told,) = last.holder.to_send()
    assert isinstance(told, SendEnd)
    assert told == SendEnd("run", 301, "failed", "no part there")
    last.holder.end_told(told, 4.0)
    assert list(last.again().to_send()) == []


def test_who_is_not_in_a_run_does_not_end_it(bridge: Bridge) -> None:
    with pytest.raises(RunRefused, match="space 999 is not in run run"):
        bridge.holder.take_end("run", "aborted", "enough", 999, 1.0)
    stranger = Bridge()
    assert stranger.holder.take_end("run", "aborted", "enough", 999, 1.0) == []
    stranger.take_part()
    assert stranger.holder.runs["run"].closed is None


def test_an_end_stops_what_is_under_way(bridge: Bridge) -> None:
    bridge.holder.take_token(bridge.token(), 300, 1.0)
    assert bridge.holder.take_end("run", "aborted", "enough", 0, 2.0) == [Stop("run", (SegmentRound(1),), "enough")]
    assert bridge.holder.take_end("run", "aborted", "enough", 0, 2.0) == []
    assert bridge.again().again(3.0) == [Stop("run", (SegmentRound(1),), "enough")]


def test_a_text_that_does_not_fit_in_a_token_fails_its_segment() -> None:
    bridge = Bridge(300)
    bridge.take_part()
    bridge.holder.take_token(bridge.token(0), 0, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(0), 2.0, results={"one.out": "x" * 65})
    assert "65 bytes" in bridge.holder.runs["run"].over[SegmentRound(0)].failed


def test_robots_are_reserved_until_the_run_is_over_or_its_lease_is(bridge: Bridge) -> None:
    assert bridge.holder.reserved_for("b") == "run"
    assert bridge.holder.reserved_for("b", 0) == "run"
    assert bridge.holder.reserved_for("b", 300) == "", "a bridge of the run may need it"
    assert bridge.holder.reserved_for("a") == ""
    due = bridge.holder.next_deadline()
    assert due is not None
    assert due == bridge.parts[301].lease_s
    bridge.holder.poll(due - 1.0)
    assert bridge.holder.reserved_for("b") == "run"
    bridge.holder.poll(due)
    assert bridge.holder.reserved_for("b") == ""
    with pytest.raises(RunRefused, match="is over here: lost"):
        bridge.holder.take_token(bridge.token(), 300, due)


def with_parts(*run_ids: str) -> Bridge:
    """A bridge that has no token of these runs."""
    bridge = Bridge()
    for run_id in run_ids:
        bridge.holder.take_part(encode_part(parts_of(PLAN, run_id, "made", {}, "anna")[301]), 0.0)
    return bridge


def test_the_oldest_runs_that_are_over_everywhere_and_fetched_can_be_forgotten() -> None:
    runs = [f"run{number}" for number in range(60)]
    bridge = with_parts(*runs)
    for number, run_id in enumerate(runs):
        bridge.holder.take_end(run_id, "done", "", 300, float(number))
    assert bridge.holder.forgettable() == [], "the server may be away"
    for run_id in runs:
        bridge.holder.fetched(run_id, 100.0)
        bridge.holder.fetched(run_id, 101.0)
    assert sum(isinstance(fact, EndTold) for fact in bridge.facts) == 60, "it is noted once"
    assert bridge.holder.forgettable() == runs[:10]
    assert bridge.again().forgettable() == runs[:10]


def test_a_long_run_that_has_just_ended_and_was_fetched_is_not_the_oldest_one() -> None:
    short = [f"run{number}" for number in range(60)]
    bridge = with_parts("long", *short)
    bridge.holder.fetched("long", 1.0)  # it is under way
    for run_id in short:
        bridge.holder.take_end(run_id, "done", "", 300, 2.0)
        bridge.holder.fetched(run_id, 3.0)
    bridge.holder.take_end("long", "done", "", 300, 4.0)
    assert "long" not in bridge.holder.forgettable()
    bridge.holder.fetched("long", 5.0)
    for holder in (bridge.holder, bridge.again()):
        assert holder.forgettable() == short[:11], "the answer to the server may be lost"


def test_a_run_that_the_server_still_asks_for_stays(bridge: Bridge) -> None:
    bridge.holder.take_end("run", "done", "", 300, 1.0)
    for number in range(60):
        run_id = f"run{number}"
        bridge.holder.take_part(encode_part(parts_of(PLAN, run_id, "made", {}, "anna")[301]), 2.0)
        bridge.holder.take_end(run_id, "done", "", 300, 3.0)
        bridge.holder.fetched(run_id, 4.0 + number)
        bridge.holder.fetched("run", 4.0 + number)
    assert bridge.holder.forgettable() == [f"run{number}" for number in range(11)]


def test_a_run_that_the_server_has_ended_is_not_kept_until_it_fetches_it() -> None:
    runs = [f"run{number}" for number in range(60)]
    bridge = with_parts(*runs)
    for number, run_id in enumerate(runs):
        if number % 2:
            bridge.holder.take_end(run_id, "done", "", 300, 1.0)
        bridge.holder.take_end(run_id, "aborted", "enough", 0, 2.0)
    assert bridge.holder.forgettable() == runs[:10]
    assert bridge.again().forgettable() == runs[:10]


def test_what_no_server_fetches_is_not_kept_for_ever() -> None:
    bridge = Bridge()
    for number in range(MOST_UNFETCHED + 10):
        part = parts_of(PLAN, f"run{number}", "made", {}, "anna")[301]
        bridge.holder.take_part(encode_part(part), float(number))
        bridge.holder.take_end(f"run{number}", "done", "", 300, float(number))
    assert bridge.holder.forgettable() == [f"run{number}" for number in range(10)]
    assert not bridge.holder.is_fetched("run0")


def test_a_paused_run_takes_tokens_and_begins_them_when_it_goes_on(bridge: Bridge) -> None:
    assert bridge.holder.take_pause("run", True, "anna", 1.0) == []
    assert bridge.holder.take_token(bridge.token(), 300, 2.0) == []
    assert bridge.again().again(3.0) == []
    held = bridge.holder.runs["run"]
    assert (held.active, held.holds) == ((), (SegmentRound(1),)), "it waits here"
    (begun,) = bridge.again().take_pause("run", False, "anna", 4.0)
    assert isinstance(begun, Begin)
    assert begun.values == {"one.out": 2.0}


def test_what_is_under_way_is_paused_once_and_again_after_a_restart(bridge: Bridge) -> None:
    bridge.holder.take_token(bridge.token(), 300, 1.0)
    assert bridge.holder.take_pause("run", True, "anna", 2.0) == [Pause("run", (SegmentRound(1),), True, "anna")]
    assert bridge.holder.take_pause("run", True, "otto", 3.0) == []
    assert bridge.again().again(4.0) == [Pause("run", (SegmentRound(1),), True, "anna")]
    begun, goes_on = bridge.again().take_pause("run", False, "otto", 5.0)
    assert isinstance(begun, Begin)
    assert goes_on == Pause("run", (SegmentRound(1),), False, "otto")


def test_a_paused_run_is_not_lost_and_one_that_is_over_or_unknown_is_not_paused(bridge: Bridge) -> None:
    bridge.holder.take_pause("run", True, "anna", 1.0)
    assert bridge.holder.next_deadline() is None
    assert bridge.holder.poll(1e9) == []
    bridge.holder.take_end("run", "aborted", "enough", 0, 2.0)
    assert bridge.holder.take_pause("run", False, "anna", 3.0) == []
    with pytest.raises(RunRefused, match="no part of run other"):
        bridge.holder.take_pause("other", True, "anna", 4.0)


def test_an_end_is_said_also_where_its_reason_is_long(bridge: Bridge) -> None:
    last = Bridge(300)
    last.take_part()
    last.holder.take_token(last.token(2), 301, 1.0)
    last.holder.segment_ended("run", SegmentRound(2), 2.0, failed="é\x00" * 5000)
    (sent,) = last.holder.to_send()
    assert isinstance(sent, SendEnd)
    words = decode_words(encode_words(run=sent.run_id, outcome=sent.outcome, reason=sent.reason))
    assert bridge.holder.take_end(words["run"], words["outcome"], words["reason"], 300, 3.0) == []
    closed = bridge.holder.runs["run"].closed
    assert closed is not None
    assert closed.outcome == "failed"
    assert closed.reason.startswith("é\x00é")
    told = decode_words(encode_words(**last.holder.asked_epoch(last.holder.runs["run"], 301)))
    assert told == {"epoch": 1, "left_out": False, "outcome": "failed", "reason": closed.reason}


def test_that_a_run_is_lost_is_told_to_those_alone_that_take_something_from_the_bridge() -> None:
    away = plan(task("one", "a"), task("two", "b"), task("three", "c"))
    bridge = Bridge()
    for number in range(60):
        bridge.parts = parts_of(away, f"run{number}", "made", {}, "anna")
        bridge.take_part()
    assert bridge.parts[301].tells() == {302}
    assert bridge.parts[302].tells() == {300, 301, 302}, "the last one tells all"
    bridge.holder.poll(1e9)
    told = list(bridge.holder.to_send())
    assert {(sent.space, sent.outcome) for sent in told if isinstance(sent, SendEnd)} == {(302, LOST)}
    assert len(told) == 60
    assert bridge.holder.forgettable() == []
    for sent in told:
        assert isinstance(sent, SendEnd)
        bridge.holder.fetched(sent.run_id, 1e9)
    assert bridge.holder.forgettable() == [], "another bridge has not heard of it"
    for sent in told:
        assert isinstance(sent, SendEnd)
        bridge.holder.end_told(sent, 1e9)
    assert list(bridge.holder.to_send()) == []
    assert bridge.holder.forgettable() == [f"run{number}" for number in range(10)]
