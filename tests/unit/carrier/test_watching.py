"""What a bridge tells of the runs that it carries."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from typing import Any, cast

import pytest
from ua_demo.simulators.fleet.memory import VirtualLoop

from tests.unit.carrying.test_plan import plan, task
from ua_fleet.bridge.carry import CarryGround
from ua_fleet.carrier.watching import FLUSH_S, HAND_OVER_S, MOST_TASKS, RunWatch
from ua_fleet.carrying import Holder, SendToken, encode_part, encode_token, parts_of
from ua_fleet.carrying.token import SegmentRound, Token
from ua_fleet.counters import Counters
from ua_fleet.monitoring import Mistakes
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.pubsub.publisher import Publisher
from ua_fleet.pubsub.run_data import RUN_DATA_FIELDS, RUN_DATA_ID
from ua_fleet.pubsub.timing import PubSubTiming
from ua_fleet.resilience import Aborted, Ranked, Ranking, ReplacementChosen, Synthesis, Weights
from ua_fleet.scenario.facts import Fact, StepEnded, StepState, TaskAssigned, TaskOutcome, TaskOver, Then
from ua_fleet.values import UNIX_EPOCH_TICKS
from ua_fleet.wire import Codec
from ua_fleet.wire.messages import FrameKind, NetworkMessage

RUN = "20260101-000001-000000"
PARTS = parts_of(plan(task("one", "a"), task("two", "b")), RUN, "made", {}, "eva")


class Bridge:
    """The bridge of space 300: its holder, what watches it, and what was sent."""

    def __init__(self) -> None:
        self.now = 0.0
        self.sent: list[bytes] = []
        self.loop, mistakes = VirtualLoop(lambda: self.now), Mistakes()
        self.mistakes = mistakes
        publisher = Publisher(300, PubSubTiming(), Counters(), Codec())
        ground = CarryGround(
            publisher,
            *cast("tuple[Any, Any, Any]", (None, None, None)),
            Counters(),
            mistakes,
            self.loop,
            send=self.sent.append,
            send_to=lambda _datagram, _address: None,
            wall_ticks=lambda: UNIX_EPOCH_TICKS + round(self.now * 10_000_000),
            sooner=lambda: None,
            must_be_verified=False,
            answers=lambda _address, sender: sender,
            limits=cast("Any", None),
        )
        self.holder = Holder(300, lambda _fact: None)
        self.watch = RunWatch(300, 2, "cell", ground)

    def begin(self, *, is_paused: bool = False) -> None:
        part = PARTS[300]
        self.holder.take_part(encode_part(part), 1.0)
        if is_paused:
            self.holder.take_pause(RUN, True, "anna", 1.0)
        self.holder.take_token(encode_token(Token(RUN, part.plan_hash, 1, 0, 0), ()), 0, 1.0)
        self.watch.look(self.holder)

    def told(self, after_s: float = FLUSH_S) -> list[dict[str, Any]]:
        """What was told since the last time, by the names of the fields."""
        self.now += after_s
        self.loop.run_ready()
        assert not self.mistakes.count, self.mistakes.text()
        datagrams, self.sent[:] = list(self.sent), []
        found: list[dict[str, Any]] = []
        for message in map(Codec().decode, datagrams):
            for part in message.messages if isinstance(message, NetworkMessage) else ():
                if part.kind == FrameKind.KEY and part.values:
                    assert part.data_set_writer_id == RUN_DATA_ID
                    names = [field.name for field in RUN_DATA_FIELDS]
                    found.append(dict(zip(names, part.values, strict=True)))
        return found

    def settled(self) -> list[dict[str, Any]]:
        """What is told where nothing happens for a while."""
        return [*self.told(HAND_OVER_S), *self.told()]


def assigned(step: str = "0", name: str = "one", robot: str = "a", attempt: int = 1) -> TaskAssigned:
    return TaskAssigned(1.0, step, name, attempt, robot, "00" * 16, "work")


def over(outcome: TaskOutcome = TaskOutcome.DONE, message: str = "", step: str = "0") -> TaskOver:
    return TaskOver(2.0, step, 1, outcome, Then.DONE, message)


def decided(event: Any) -> DecisionChanged:
    return DecisionChanged(f"{RUN}.0", "0", "one", "a", "the drive does not turn", event)


def test_a_step_is_told_when_it_begins_and_when_its_token_is_on_the_way() -> None:
    bridge = Bridge()
    bridge.begin()
    assert bridge.told() == [], "nothing has happened yet"
    bridge.watch.happened(RUN, assigned())
    (begun,) = bridge.told()
    assert (begun["Run"], list(begun["Holds"]), list(begun["HandsTo"])) == (RUN, [0], [])
    assert [list(begun[name]) for name in ("Tasks", "Robots", "States")] == [["one"], ["a"], ["assigned"]]
    assert (begun["Facts"], begun["Outcome"]) == (1, "")

    bridge.watch.happened(RUN, over())
    bridge.holder.segment_ended(RUN, SegmentRound(0), 2.0, results={})
    bridge.watch.look(bridge.holder)
    assert bridge.told() == [], "mostly it has arrived soon"
    (ended,) = bridge.told(HAND_OVER_S)
    assert (list(ended["Holds"]), list(ended["HandsTo"])) == ([], [301])
    assert list(ended["States"]) == ["done"]
    assert ended["Facts"] == 2

    (sending,) = bridge.holder.to_send()
    assert isinstance(sending, SendToken)
    bridge.holder.handed_over(sending, 3.0)
    bridge.watch.look(bridge.holder)
    (arrived,) = bridge.told()
    assert list(arrived["HandsTo"]) == [], "it was told to be on its way"
    assert list(arrived["Tasks"]) == []


def test_a_token_that_arrives_at_once_is_no_message_of_its_own() -> None:
    bridge = Bridge()
    bridge.begin()
    bridge.watch.happened(RUN, assigned())
    bridge.watch.happened(RUN, over())
    bridge.holder.segment_ended(RUN, SegmentRound(0), 2.0, results={})
    bridge.watch.look(bridge.holder)
    (sending,) = bridge.holder.to_send()
    assert isinstance(sending, SendToken)
    bridge.holder.handed_over(sending, 3.0)
    bridge.watch.look(bridge.holder)
    (told,) = bridge.told()
    assert list(told["States"]) == ["assigned", "done"]
    assert list(told["HandsTo"]) == []
    assert bridge.told() == []


def test_a_token_that_rests_is_told_once_and_so_is_one_that_is_gone_without_a_task() -> None:
    bridge = Bridge()
    bridge.begin(is_paused=True)
    assert bridge.holder.runs[RUN].active == ()
    assert bridge.told(HAND_OVER_S - FLUSH_S) == [], "mostly a task begins with it"
    (rests,) = bridge.settled()
    assert (list(rests["Holds"]), list(rests["Tasks"])) == ([0], [])
    bridge.watch.look(bridge.holder)
    assert bridge.settled() == []

    bridge.holder.take_pause(RUN, False, "anna", 2.0)
    bridge.watch.look(bridge.holder)
    assert bridge.settled() == [], "it has it as before"
    bridge.holder.segment_ended(RUN, SegmentRound(0), 2.0, results={})
    (sending,) = bridge.holder.to_send()
    assert isinstance(sending, SendToken)
    bridge.holder.handed_over(sending, 3.0)
    bridge.watch.look(bridge.holder)
    (gone,) = bridge.settled()
    assert (list(gone["Holds"]), list(gone["HandsTo"])) == ([], [])
    assert bridge.settled() == []


def test_what_a_step_tells_is_not_told_once_more() -> None:
    bridge = Bridge()
    bridge.begin()
    bridge.watch.happened(RUN, assigned())
    assert len(bridge.told()) == 1
    bridge.watch.look(bridge.holder)
    assert bridge.settled() == []


def test_a_run_that_is_forgotten_is_told_no_more() -> None:
    bridge = Bridge()
    bridge.begin()
    bridge.watch.forget(RUN)
    assert bridge.settled() == []


def test_a_fault_is_told_with_the_ranking() -> None:
    bridge = Bridge()
    bridge.begin()
    ranked = tuple([Ranked(name, score, (), (), ()) for name, score in (("b", 0.75), ("c", 0.25))])
    ranking = Ranking(Weights((), (), 0.0, 0.0), Synthesis.DISTRIBUTIVE, ranked, ())
    bridge.watch.happened(RUN, assigned())
    bridge.watch.happened(RUN, over(TaskOutcome.FAULT, "the drive does not turn" * 9))
    bridge.watch.decided(RUN, decided(ReplacementChosen("d1", "b", "automatic", ranking)))
    bridge.watch.happened(RUN, assigned(robot="b", attempt=2))
    (told,) = bridge.told()
    assert list(told["States"]) == ["assigned", "fault", "assigned"]
    assert list(told["Robots"]) == ["a", "a", "b"]
    assert (list(told["Candidates"]), list(told["Scores"])) == (["b", "c"], [0.75, 0.25])
    bridge.watch.decided(RUN, decided(Aborted("d2", "nobody can")))
    (told,) = bridge.told()
    assert list(told["Candidates"]) == [], "a ranking is told once"


def test_the_bridge_that_ends_a_run_tells_it_and_the_others_do_not() -> None:
    for by, outcomes in ((301, []), (300, ["failed"])):
        bridge = Bridge()
        bridge.begin()
        bridge.holder.take_end(RUN, "failed", "it is broken", by, 2.0)
        bridge.watch.look(bridge.holder)
        assert [told["Outcome"] for told in bridge.told()] == outcomes


def test_one_message_has_a_bounded_number_of_tasks_and_what_was_told_before_a_restart_counts() -> None:
    bridge = Bridge()
    bridge.begin()
    bridge.watch.restored(RUN, [assigned(), over()], 7)
    assert bridge.told() == []
    for number in range(20):
        bridge.watch.happened(RUN, assigned(str(number), f"t{number}"))
    (told,) = bridge.told()
    assert list(told["Tasks"]) == [f"t{number}" for number in range(20 - MOST_TASKS, 20)]
    assert told["Facts"] == 27, "seven were counted at most, and others than these two may be forgotten"
    bridge.watch.forget(RUN)
    assert bridge.told() == []


def test_what_is_known_of_tasks_does_not_grow_with_rounds() -> None:
    def facts(rounds: int) -> Iterator[Fact]:
        for step in [f"0@{number}" for number in range(rounds)]:
            yield from (assigned(step), over(step=step), StepEnded(3.0, step, StepState.DONE))

    bridge = Bridge()
    tracemalloc.start()
    try:
        bridge.watch.restored(RUN, facts(10), 30)
        before, _ = tracemalloc.get_traced_memory()
        bridge.watch.restored(RUN, facts(2000), 6030)
        assert tracemalloc.get_traced_memory()[0] - before < 20_000
    finally:
        tracemalloc.stop()
    bridge.watch.happened(RUN, assigned("0@9999"))
    bridge.watch.happened(RUN, over(step="0@9999"))
    (told,) = bridge.told()
    assert list(told["Tasks"]) == ["one", "one"], "the name is known until the step has ended"
    assert told["Facts"] == 3 * 2010 + 2


@pytest.mark.parametrize("count", [1, 8])
def test_it_is_small(count: int) -> None:
    bridge = Bridge()
    bridge.begin()
    for number in range(count):
        bridge.watch.happened(RUN, assigned(str(number), f"task_{number}", "pioneer_1"))
    bridge.now += FLUSH_S
    bridge.loop.run_ready()
    assert len(bridge.sent[-1]) <= 200 * count
