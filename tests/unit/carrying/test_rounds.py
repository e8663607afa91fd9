"""What a bridge does with rounds of repetitions, and with what comes to mailboxes."""

from __future__ import annotations

import pytest

from tests.unit.carrying.test_holder import Bridge
from tests.unit.carrying.test_plan import plan, task
from ua_fleet.carrying import (
    Begin,
    SegmentRound,
    SendToken,
    Tell,
    Token,
    decode_token,
    encode_part,
    encode_token,
    parts_of,
)
from ua_fleet.carrying.adoption import Adoption, encode_adoption, plan_without
from ua_fleet.carrying.effects import Carry
from ua_fleet.carrying.plan import MailSlot

LOOP = plan(task("first", "a"), {"repeat": [task("one", "a"), task("two", "b")], "times": 1_000_000})
HEAD = next(number for number, one in enumerate(LOOP.segments) if one.loops)
MINE = next(number for number, one in enumerate(LOOP.segments) if one.loops and one.space == 301)


def round_token(number: int) -> bytes:
    made = parts_of(LOOP, "run", "made", {}, "anna")[301]
    return encode_token(Token("run", made.plan_hash, 1, MINE, 0, rounds=(number,)), ())


def looping() -> Bridge:
    bridge = Bridge()
    bridge.parts = parts_of(LOOP, "run", "made", {}, "anna")
    bridge.take_part()
    return bridge


def test_a_segment_is_begun_once_in_each_round_and_its_token_is_for_the_next_one() -> None:
    bridge = looping()
    for number in range(3):
        (begun,) = bridge.holder.take_token(round_token(number), 300, 1.0)
        assert isinstance(begun, Begin)
        assert (begun.segment.number, begun.rounds) == (MINE, (number,))
        assert bridge.holder.take_token(round_token(number), 300, 1.5) == []
        assert bridge.again().take_token(round_token(number), 300, 1.5) == []
        bridge.holder.segment_ended("run", SegmentRound(MINE, (number,)), 2.0)
        (sent,) = bridge.holder.to_send()
        assert isinstance(sent, SendToken)
        assert decode_token(sent.content).place == SegmentRound(HEAD, (number + 1,))
        bridge.holder.handed_over(sent, 3.0)


def test_a_token_of_a_round_that_is_over_is_acknowledged_and_begins_nothing() -> None:
    bridge = looping()
    bridge.holder.take_token(round_token(7), 300, 1.0)
    count = len(bridge.facts)
    assert bridge.holder.take_token(round_token(6), 300, 2.0) == []
    assert len(bridge.facts) == count


def test_what_a_bridge_knows_of_a_run_does_not_grow_with_its_rounds() -> None:
    bridge = looping()
    for number in range(300):
        bridge.holder.take_token(round_token(number), 300, 1.0)
        bridge.holder.segment_ended("run", SegmentRound(MINE, (number,)), 2.0)
        for sent in list(bridge.holder.to_send()):
            assert isinstance(sent, SendToken)
            bridge.holder.handed_over(sent, 3.0)
    for held in (bridge.holder.runs["run"], bridge.again().runs["run"]):
        assert max(len(held.tokens), len(held.begun), len(held.over), len(held.handed)) <= 2


def test_what_was_not_handed_over_of_a_round_before_is_still_said() -> None:
    bridge = looping()
    bridge.holder.take_token(round_token(0), 300, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(MINE, (0,)), 2.0)
    bridge.holder.take_token(round_token(1), 300, 3.0)
    assert [sent.source for sent in bridge.holder.to_send() if isinstance(sent, SendToken)] == [
        SegmentRound(MINE, (0,))
    ]


WAITING = plan(
    {
        "parallel": [
            [task("one", "a"), task("two", "a")],
            [task("three", "b", after=["one"], arguments={"x": "=one.out"})],
        ]
    }
)
MAILBOX = next(number for number, one in enumerate(WAITING.segments) if one.tells)
ONE = next(number for number, one in enumerate(WAITING.segments) if one.lost)
HEARING = next(number for number, one in enumerate(WAITING.segments) if one.hears)


def mail(slot: MailSlot, value: float = 0.0) -> bytes:
    made = parts_of(WAITING, "run", "made", {}, "anna")[301]
    values = {"one.out": value} if slot is MailSlot.DONE else {}
    return encode_token(Token("run", made.plan_hash, 1, MAILBOX, slot, "", values), list(values))


@pytest.mark.parametrize("is_before", [True, False])
def test_what_comes_to_a_mailbox_is_told_to_who_hears_it(is_before: bool) -> None:
    bridge = Bridge()
    bridge.parts = parts_of(WAITING, "run", "made", {}, "anna")
    bridge.take_part()
    begins = encode_token(Token("run", bridge.parts[301].plan_hash, 1, HEARING, 0), ())
    tell = Tell("run", SegmentRound(HEARING), "one", True, {"out": 4.0})
    if is_before:
        assert bridge.holder.take_token(mail(MailSlot.DONE, 4.0), 300, 1.0) == []
        assert bridge.holder.runs["run"].holds == (), "what is in a mailbox begins nothing"
        begun, told = bridge.holder.take_token(begins, 300, 2.0)
    else:
        (begun,) = bridge.holder.take_token(begins, 300, 1.0)
        (told,) = bridge.holder.take_token(mail(MailSlot.DONE, 4.0), 300, 2.0)
    assert isinstance(begun, Begin)
    assert begun.outside == ("one",)
    assert told == tell
    assert bridge.holder.take_token(mail(MailSlot.LOST), 300, 3.0) == [tell], "it was done before its branch failed"
    assert [one for one in bridge.again().again(4.0) if isinstance(one, Tell)] == [tell]


def test_a_branch_that_fails_says_that_what_others_wait_for_will_not_be_done() -> None:
    bridge = Bridge(300)
    bridge.parts = parts_of(WAITING, "run", "made", {}, "anna")
    bridge.take_part()
    first = encode_token(Token("run", bridge.parts[300].plan_hash, 1, 0, 0), ())
    bridge.holder.take_token(first, 0, 1.0)
    bridge.holder.segment_ended("run", SegmentRound(0), 2.0)
    bridge.holder.segment_ended("run", SegmentRound(ONE), 3.0, failed="no part there")
    sent = [one for one in bridge.holder.to_send() if isinstance(one, SendToken) and one.road.segment == MAILBOX]
    assert [one.road.slot for one in sent] == [MailSlot.LOST]
    waiting = Bridge()
    waiting.parts = bridge.parts
    waiting.take_part()
    assert waiting.holder.take_token(sent[0].content, 300, 4.0) == []


READ = plan(
    task("first", "b"),
    {
        "parallel": [
            [{"repeat": [task("x", "b"), task("one", "a"), task("y", "a")], "times": 3}],
            [task("slow", "c"), task("u", "b", arguments={"x": "=one.out"})],
        ]
    },
)
"""`u` reads of a repetition beside it, as it stands when `u` begins."""
READ_HEAD = next(number for number, one in enumerate(READ.segments) if one.otherwise)
READ_MAILBOX = next(number for number, one in enumerate(READ.segments) if one.tells)
READ_ONE = next(
    number for number, one in enumerate(READ.segments) if READ_MAILBOX in [edge.segment for edge in one.then]
)
READ_U = next(number for number, one in enumerate(READ.segments) if one.hears)


def test_what_a_mailbox_got_in_a_round_before_is_told_to_who_begins_later() -> None:
    bridge = Bridge()
    bridge.parts = parts_of(READ, "run", "made", {}, "anna")
    bridge.take_part()

    def take(segment: int, sender: int, rounds: tuple[int, ...] = (), value: float = 0.0) -> list[Carry]:
        needs = READ.segments[segment].needs[0]
        made = Token("run", bridge.parts[301].plan_hash, 1, segment, 0, "", dict.fromkeys(needs, value), rounds)
        return bridge.holder.take_token(encode_token(made, needs), sender, 1.0)

    for number in range(3):
        take(READ_HEAD, 300, (number,))
        take(READ_MAILBOX, 300, (number,), float(number))
    take(READ_HEAD, 300, (3,))
    assert take(READ_U, 302)[1:] == [Tell("run", SegmentRound(READ_U), "one", True, {"out": 2.0})]
    for held in (bridge.holder.runs["run"], bridge.again().runs["run"]):
        assert sum(place.number == READ_MAILBOX for place, _ in held.tokens) == 1, "only the newest is kept"


def test_what_was_told_to_the_mailbox_of_a_bridge_that_is_off_is_told_to_its_heir() -> None:
    bridge = Bridge(300)
    bridge.parts = parts_of(READ, "run", "made", {}, "anna", adopt_after_s=10.0)
    bridge.take_part()
    y = next(edge.segment for edge in READ.segments[READ_ONE].then if edge.segment != READ_MAILBOX)
    needs = READ.segments[READ_ONE].needs[0]
    for number in range(3):
        token = Token("run", bridge.parts[300].plan_hash, 1, READ_ONE, 0, rounds=(number,))
        bridge.holder.take_token(encode_token(token, needs), 301, 1.0)
        if number < 2:
            for segment in (READ_ONE, y):
                bridge.holder.segment_ended("run", SegmentRound(segment, (number,)), 2.0, results={"one.out": number})
            for sent in list(bridge.holder.to_send()):
                assert isinstance(sent, SendToken)
                bridge.holder.handed_over(sent, 3.0)
    parts = parts_of(plan_without(READ, 301, 302), "run", "made", {}, "anna", adopt_after_s=10.0, epoch=2)
    bridge.holder.take_adoption(encode_adoption(Adoption(parts[300], (301,), "anna"), encode_part(parts[300])), 4.0)
    for holder in (bridge.holder, bridge.again()):
        told = [sent for sent in holder.to_send() if isinstance(sent, SendToken) and sent.road.segment == READ_MAILBOX]
        assert [(sent.road.space, sent.source.rounds) for sent in told] == [(302, (1,))]
