"""What a bridge does where its disk has no room for a fact: what was acknowledged is not lost."""

from __future__ import annotations

import pytest

from tests.unit.carrying.test_holder import PLAN, Bridge
from tests.unit.carrying.test_plan import plan, task
from ua_fleet.carrying import (
    Begin,
    Gone,
    Holder,
    SegmentRound,
    SendEnd,
    SendToken,
    Token,
    encode_part,
    encode_token,
    parts_of,
)
from ua_fleet.carrying.adoption import Adoption, encode_adoption, plan_without
from ua_fleet.carrying.facts import CarryFact, HandedOver, RunClosed, SegmentBegun, SegmentOver, TokenTaken
from ua_fleet.carrying.holder import AGAIN_S
from ua_fleet.errors import StorageUnavailable


class FullBridge(Bridge):
    """A bridge whose disk has no room for some facts."""

    def __init__(self, space: int = 301) -> None:
        super().__init__(space)
        self.refused: list[type[CarryFact]] = []
        self.holder = Holder(space, self.write)
        self.take_part()

    def write(self, fact: CarryFact) -> None:
        if self.refused and isinstance(fact, self.refused[0]):
            del self.refused[0]
            raise StorageUnavailable("the disk is full")
        self.facts.append(fact)

    def closed(self) -> tuple[str, str]:
        closed = self.holder.runs["run"].closed
        assert closed is not None
        return closed.outcome, closed.reason


def test_a_token_that_is_said_again_begins_what_could_not_be_written_before() -> None:
    for is_polled in (False, True):
        bridge = FullBridge()
        bridge.refused = [SegmentBegun]
        with pytest.raises(StorageUnavailable):
            bridge.holder.take_token(bridge.token(), 300, 1.0)
        assert bridge.holder.problem == "the disk is full"
        assert bridge.holder.next_deadline() == 1.0 + AGAIN_S
        assert bridge.holder.poll(1.5) == []
        again = bridge.holder.poll(2.0) if is_polled else bridge.holder.take_token(bridge.token(), 300, 1.5)
        assert [type(one) for one in again] == [Begin]
        assert bridge.holder.problem == ""
        assert bridge.holder.take_token(bridge.token(), 300, 3.0) == bridge.holder.poll(4.0) == []


def test_what_follows_from_a_pause_or_an_adoption_is_gone_over_again() -> None:
    bridge = FullBridge()
    bridge.holder.take_pause("run", True, "anna", 1.0)
    bridge.holder.take_token(bridge.token(), 300, 1.0)
    bridge.refused = [SegmentBegun]
    with pytest.raises(StorageUnavailable):
        bridge.holder.take_pause("run", False, "anna", 2.0)
    assert [type(one) for one in bridge.holder.take_pause("run", False, "anna", 2.1)] == [Begin]
    bridge = FullBridge()
    part = parts_of(plan_without(PLAN, 300, 301), "run", "made", {}, "anna", epoch=2)[301]
    adoption = encode_adoption(Adoption(part, (300,), "anna"), encode_part(part))
    bridge.refused = [SegmentBegun, SegmentBegun]
    for now in (1.0, 2.0):
        with pytest.raises(StorageUnavailable):
            bridge.holder.take_adoption(adoption, now)
    assert [type(one) for one in bridge.holder.take_adoption(adoption, 3.0)] == [Gone, Begin]


@pytest.mark.parametrize("refused", [[SegmentOver], [RunClosed], [SegmentOver, RunClosed]])
@pytest.mark.parametrize("said", ["done", "failed", "aborted"])
@pytest.mark.parametrize("is_killed", [False, True])
def test_the_end_of_a_run_that_could_not_be_written_is_written_later(
    refused: list[type[CarryFact]], said: str, is_killed: bool
) -> None:
    bridge = FullBridge(300)
    bridge.holder.take_token(bridge.token(2), 301, 1.0)
    end = {"failed": {"failed": "no part"}, "aborted": {"ends": "aborted", "reason": "no part"}}.get(said, {})
    bridge.refused = list(refused)
    for now, _ in enumerate(refused):
        with pytest.raises(StorageUnavailable):
            bridge.holder.segment_ended("run", SegmentRound(2), 2.0 + now, **end)  # type: ignore[arg-type]
    if is_killed:
        bridge.holder = bridge.again()
        bridge.holder.again(9.0)
    bridge.holder.segment_ended("run", SegmentRound(2), 9.5, **end)  # type: ignore[arg-type]
    assert bridge.closed() == (said, "" if said == "done" else "no part")
    assert [type(one) for one in bridge.holder.to_send()] == [SendEnd]


@pytest.mark.parametrize("kind", [TokenTaken, HandedOver, SegmentBegun])
def test_a_token_within_a_bridge_is_gone_over_again(kind: type[CarryFact]) -> None:
    local = plan({"parallel": [[task("one", "a")], [task("two", "b"), task("three", "c")]]})
    assert local.segments[0].steps == []
    assert 300 in [local.segments[edge.segment].space for edge in local.segments[0].then]
    bridge = FullBridge(300)
    bridge.parts = parts_of(local, "run", "made", {}, "anna")
    bridge.holder = Holder(300, bridge.write)
    bridge.take_part()
    bridge.holder.take_token(encode_token(Token("run", bridge.parts[300].plan_hash, 1, 0, 0), ()), 0, 1.0)
    bridge.refused = [kind]
    with pytest.raises(StorageUnavailable):
        bridge.holder.segment_ended("run", SegmentRound(0), 2.0)
    begun = [one for one in bridge.holder.segment_ended("run", SegmentRound(0), 3.0) if isinstance(one, Begin)]
    assert [one.segment.body.steps[0].key for one in begun] == ["0.0.0"]
    assert len([sent for sent in bridge.holder.to_send() if isinstance(sent, SendToken)]) == 1
