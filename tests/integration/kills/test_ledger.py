"""The ledger notices what it is there for."""

from __future__ import annotations

import pytest

from tests.integration.kills.ledger import keep
from ua_fleet.scenario.facts import Fact, RunEnded, RunOutcome, TaskAssigned, TaskOutcome, TaskOver, Then


def attempt(execution_id: str, outcome: TaskOutcome | None, robot: str = "left") -> list[Fact]:
    assigned = TaskAssigned(0.0, "0", "t", 1, robot, execution_id, "work")
    return [assigned] if outcome is None else [assigned, TaskOver(1.0, "0", 1, outcome, Then.DONE)]


END = RunEnded(2.0, RunOutcome.DONE)


def test_what_is_right() -> None:
    facts = [
        *attempt("a", TaskOutcome.FAILED),
        *attempt("b", TaskOutcome.DONE),
        *attempt("c", TaskOutcome.REFUSED),
        END,
    ]
    ledger = keep(facts, [("left", "a"), ("left", "b")])
    assert (ledger.doubled, ledger.lost, ledger.invented) == ([], [], [])
    assert str(ledger).startswith("3 executions: 1 done, 1 failed, 1 never begun, 0 unknown")


@pytest.mark.parametrize("times", [0, 1])
def test_unknown_may_have_been_done_or_not(times: int) -> None:
    ledger = keep([*attempt("a", TaskOutcome.UNKNOWN), END], [("left", "a")] * times)
    assert (ledger.unknown, ledger.doubled, ledger.lost, ledger.invented) == (["a"], [], [], [])


def test_what_is_told_after_all_is_not_unknown() -> None:
    unknown = attempt("a", TaskOutcome.UNKNOWN)
    ledger = keep([*unknown, TaskOver(1.5, "0", 1, TaskOutcome.DONE, Then.DONE), END], [("left", "a")])
    assert (ledger.unknown, ledger.done, ledger.lost, ledger.invented) == ([], 1, [], [])


@pytest.mark.parametrize(
    ("outcome", "told", "doubled", "lost", "invented"),
    [
        (TaskOutcome.DONE, [("left", "a")] * 2, ["a"], [], []),
        (TaskOutcome.UNKNOWN, [("left", "a")] * 2, ["a"], [], []),
        (TaskOutcome.DONE, [("right", "a")], ["a"], [], []),
        (TaskOutcome.DONE, [], [], ["a"], []),
        (TaskOutcome.FAILED, [], [], ["a"], []),
        (None, [("left", "a")], [], ["a"], []),
        (TaskOutcome.REFUSED, [("left", "a")], [], [], ["a"]),
        (TaskOutcome.TIMED_OUT, [("left", "a")], [], [], ["a"]),
        (TaskOutcome.DONE, [("left", "a"), ("left", "b")], [], [], ["b"]),
    ],
)
def test_what_is_wrong(
    outcome: TaskOutcome | None,
    told: list[tuple[str, str]],
    doubled: list[str],
    lost: list[str],
    invented: list[str],
) -> None:
    ledger = keep([*attempt("a", outcome), END], told)
    assert (ledger.doubled, ledger.lost, ledger.invented) == (doubled, lost, invented)
