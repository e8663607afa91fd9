"""Parts of a scenario that bridges run: decisions for others, rounds around them, and tasks of other branches."""

from __future__ import annotations

from typing import Any

import pytest

from ua_fleet.scenario import Run, Scenario, Value, ValueUnknown, parse_expression
from ua_fleet.scenario.effects import Effect, StartTask, WantRobot
from ua_fleet.scenario.facts import (
    BranchTaken,
    Fact,
    IterationStarted,
    RunOutcome,
    StepEnded,
    StepState,
    TaskOutcome,
    decode_fact,
    encode_fact,
)
from ua_fleet.scenario.model import BranchPoint, Sequence, Step, Task

LEVELS: dict[str, Value] = {"b.level": 5.0}


def known(name: str) -> Value:
    if name in LEVELS:
        return LEVELS[name]
    raise ValueUnknown(f"{name} is not known")


def nothing(name: str) -> Value:
    raise ValueUnknown(f"{name} is not known")


class Part:
    """A run of some steps in the rounds of a scope, with its journal."""

    def __init__(self, *steps: Step, scope: str = "", outside: tuple[str, ...] = ()) -> None:
        self.scenario = Scenario("part", Sequence("", 0, steps), "", (), "{}", scope, frozenset(outside))
        self.facts: list[Fact] = []
        self.run = Run.create("run", self.scenario, {}, self.facts.append, by="x", now=0.0)

    def again(self) -> Run:
        """The run of the next process."""
        return Run.restore(self.scenario, [decode_fact(encode_fact(fact)) for fact in self.facts], self.facts.append)

    def noted(self, *kinds: type[Any]) -> list[Fact]:
        return [fact for fact in self.facts if isinstance(fact, kinds)]


def branch(text: str) -> BranchPoint:
    return BranchPoint("3", 1, parse_expression(text))


def loop(number: int, *, times: int | None = None, text: str = "") -> BranchPoint:
    condition = parse_expression(text) if text else None
    return BranchPoint("3", 1, condition, is_loop=True, times=times, round=number)


@pytest.mark.parametrize(("text", "then"), [("b.level > 3", True), ("b.level > 9", False)])
def test_a_way_is_decided_once_and_left_to_others(text: str, then: bool) -> None:
    part = Part(branch(text), scope="@4")
    part.run.poll(known, 1.0)
    assert part.noted(BranchTaken) == [BranchTaken(1.0, "3@4", then)]
    assert part.run.state.outcome is RunOutcome.DONE
    assert "3@4" not in part.run.state.ended, "what follows is under way elsewhere"


def test_a_decision_that_is_written_down_is_not_made_again() -> None:
    part = Part(branch("b.level > 3"))
    part.facts.append(BranchTaken(0.5, "3", False))
    run = part.again()
    run.poll(known, 1.0)
    assert part.noted(BranchTaken) == [BranchTaken(0.5, "3", False)]
    assert run.state.outcome is RunOutcome.DONE


def test_a_decision_waits_for_its_value_and_fails_without_it() -> None:
    part = Part(branch("b.level > 3"))
    part.run.poll(nothing, 1.0)
    assert part.run.next_deadline() == 11.0
    part.run.poll(nothing, 11.0)
    assert part.run.state.outcome is RunOutcome.FAILED
    assert "cannot be decided" in part.run.state.reason


@pytest.mark.parametrize(
    ("point", "goes_on"),
    [
        (loop(0, times=2), True),
        (loop(1, times=2), True),
        (loop(2, times=2), False),
        (loop(7, text="b.level > 3"), True),
        (loop(7, text="b.level > 9"), False),
        (loop(2, times=2, text="b.level > 3"), False),
        (loop(1, times=2, text="b.level > 9"), False),
    ],
)
def test_the_head_of_a_repetition_begins_a_round_or_ends_it(point: BranchPoint, goes_on: bool) -> None:
    part = Part(point, scope="@4")
    part.run.poll(known, 1.0)
    begun: list[Fact] = [IterationStarted(1.0, "3@4", point.round)]
    ended: list[Fact] = [StepEnded(1.0, "3@4", StepState.DONE)]
    assert part.noted(IterationStarted) == (begun if goes_on else [])
    assert [fact for fact in part.noted(StepEnded) if fact in ended] == ([] if goes_on else ended)
    assert part.run.state.outcome is RunOutcome.DONE


def after(name: str) -> Task:
    return Task("5", 1, "mine", "work", "r", after=(name,), arguments={"x": parse_expression(f"{name}.out")})


def started(effects: list[Effect], run: Run) -> list[StartTask]:
    """What is begun once the robot is free."""
    wanted = [one for one in effects if isinstance(one, WantRobot)]
    return [one for want in wanted for one in run.granted(want.step, "r", 2.0) if isinstance(one, StartTask)]


def test_a_task_waits_for_one_of_another_branch_and_reads_what_it_gave() -> None:
    part = Part(after("other"), scope="@1", outside=("other",))
    assert started(part.run.poll(known, 1.0), part.run) == []
    (begun,) = started(part.run.told("other", 1.5, is_done=True, results={"out": 3.5}), part.run)
    assert (begun.step, begun.arguments) == ("5@1", {"x": 3.5})
    assert part.run.told("other", 1.6, is_done=True, results={"out": 3.5}) == []
    assert part.run.told("other", 1.7, is_done=False, results={}) == [], "that its branch failed later changes nothing"
    run = part.again()
    assert run.state.outside == {"other": True}
    run.ended(begun.execution_id, TaskOutcome.DONE, 3.0)
    assert run.state.outcome is RunOutcome.DONE


def test_a_task_fails_whose_other_one_will_not_be_done() -> None:
    part = Part(after("other"), outside=("other",))
    part.run.poll(known, 1.0)
    part.run.told("other", 1.5, is_done=False, results={})
    assert part.run.state.outcome is RunOutcome.FAILED
    assert part.run.state.reason == "task mine comes after other, which was not done"


def test_execution_ids_follow_from_the_round() -> None:
    ids: set[str] = set()
    for scope in ("", "@0", "@1", "@1@0", "@1"):
        part = Part(Task("5", 1, "mine", "work", "r"), scope=scope)
        (begun,) = started(part.run.poll(known, 1.0), part.run)
        ids.add(begun.execution_id)
    assert len(ids) == 4
