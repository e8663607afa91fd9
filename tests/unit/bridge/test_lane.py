from __future__ import annotations

from random import Random

from ua_fleet.bridge.driver import (
    ExecutionEnded,
    ExecutionFact,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
)
from ua_fleet.bridge.lane import ExecutionLane

X, Y = b"x" * 16, b"y" * 16


def left(lane: ExecutionLane) -> list[ExecutionFact]:
    return [lane.pop() for _ in range(len(lane))]


def test_an_execution_that_is_suspended_and_resumed_without_end_takes_three_places() -> None:
    lane, pushed_out = ExecutionLane(), 0
    for number in range(10_000):
        pushed_out += lane.put(ExecutionSuspended(X, str(number)))
        pushed_out += lane.put(ExecutionProgressed(X, 0.5))
        pushed_out += lane.put(ExecutionResumed(X))
        assert len(lane) <= 3
    assert pushed_out == 30_000 - len(lane)
    assert left(lane)[-1] == ExecutionResumed(X)


def test_each_execution_has_its_own_and_the_order_stays() -> None:
    lane = ExecutionLane()
    facts: list[ExecutionFact] = [ExecutionSuspended(X), ExecutionProgressed(Y, 0.1), ExecutionResumed(X)]
    for fact in (*facts, ExecutionProgressed(Y, 0.2)):
        lane.put(fact)
    assert left(lane) == [ExecutionSuspended(X), ExecutionResumed(X), ExecutionProgressed(Y, 0.2)]


def test_ends_and_what_is_begun_anew_push_nothing_out() -> None:
    lane = ExecutionLane()
    facts: list[ExecutionFact]
    facts = [ExecutionSuspended(X), ExecutionNotBegun(X), ExecutionSuspended(X), ExecutionEnded(X), ExecutionEnded(X)]
    assert [lane.put(fact) for fact in facts] == [0] * 5
    assert left(lane) == facts


def after(facts: list[ExecutionFact], state: str) -> tuple[str, float | None]:
    """What the responder makes of the facts of one execution: its state, and how far it is."""
    fraction: float | None = None
    for fact in facts:
        if isinstance(fact, ExecutionProgressed):
            state, fraction = ("running" if state == "asking" else state), fact.progress
        elif isinstance(fact, ExecutionSuspended) and state in ("running", "asking"):
            state = "suspended"
        elif isinstance(fact, ExecutionResumed) and state == "suspended":
            state = "running"
    return state, fraction


def test_whoever_hears_the_rest_knows_the_same_in_the_end() -> None:
    random = Random(3)
    for _ in range(2_000):
        lane, facts = ExecutionLane(), list[ExecutionFact]()
        for number in range(random.randrange(1, 12)):
            said: list[ExecutionFact] = [
                ExecutionProgressed(X, float(number)),
                ExecutionSuspended(X, str(number)),
                ExecutionResumed(X),
            ]
            facts.append(random.choice(said))
            lane.put(facts[-1])
        told = left(lane)
        for state in ("running", "asking", "suspended"):
            assert after(told, state) == after(facts, state), (facts, told)
