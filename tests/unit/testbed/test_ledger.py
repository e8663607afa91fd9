"""The ledger of commands notices what it is there for."""

from __future__ import annotations

import pytest

from tests.testbed.ledger import Account, Begun, Command, Outcome, account


def command(outcome: Outcome, robot: str = "drone") -> Command:
    return Command(robot, "land", 1.0, "id", outcome)


def test_what_is_right() -> None:
    commands = [command(outcome) for outcome in (Outcome.DONE, Outcome.DONE, Outcome.REFUSED, Outcome.FAILED)]
    seen = account(commands, [Begun("drone", 1.0, "1"), Begun("drone", 2.0, "2")])
    assert seen == Account(asked=4, done=2, refused=1, failed=1)


@pytest.mark.parametrize("outcome", [Outcome.UNKNOWN, Outcome.UNANSWERED, Outcome.FAILED])
@pytest.mark.parametrize("begun", [0, 1])
def test_what_nobody_can_tell_may_have_been_done_or_not(outcome: Outcome, begun: int) -> None:
    seen = account([command(outcome)], [Begun("drone", 1.0)] * begun)
    assert (seen.lost, seen.doubled) == (0, 0)


@pytest.mark.parametrize(
    ("outcomes", "begun", "lost", "doubled"),
    [
        ([Outcome.OPEN], ["a"], 1, 0),
        ([Outcome.DONE], [], 1, 0),
        ([Outcome.DONE, Outcome.DONE], ["a"], 1, 0),
        ([Outcome.DONE], ["a", "a"], 0, 1),
        ([Outcome.DONE], ["", ""], 0, 1),
        ([Outcome.REFUSED], ["a"], 0, 1),
        ([Outcome.DONE, Outcome.UNKNOWN], ["a", "a"], 0, 1),
        ([Outcome.DONE, Outcome.DONE], ["a", "a"], 1, 1),
        ([], ["a"], 0, 1),
    ],
)
def test_what_is_wrong(outcomes: list[Outcome], begun: list[str], lost: int, doubled: int) -> None:
    seen = account([command(outcome) for outcome in outcomes], [Begun("drone", 1.0, mark) for mark in begun])
    assert (seen.lost, seen.doubled) == (lost, doubled)


def test_robots_are_held_apart() -> None:
    seen = account([command(Outcome.DONE, "ur3"), command(Outcome.DONE, "drone")], [Begun("drone", 1.0, "a")] * 2)
    assert (seen.lost, seen.doubled) == (1, 1)


def asked(at: float, outcome: Outcome = Outcome.UNKNOWN) -> Command:
    return Command("drone", "land", at, "id", outcome, within_s=8.0)


@pytest.mark.parametrize(
    ("commands", "begun", "late"),
    [
        ([asked(0.0)], [8.5], 0),
        ([asked(0.0)], [10.0], 1),
        ([asked(0.0), asked(5.0)], [10.0], 0),
        ([asked(0.0), asked(5.0)], [10.0, 10.5], 1),
        ([asked(0.0, Outcome.DONE), asked(5.0, Outcome.DONE)], [1.0, 5.5], 0),
        ([asked(0.0), asked(5.0)], [5.5, 6.0], 0),
        ([asked(5.0, Outcome.REFUSED)], [5.5], 0),
        ([asked(5.0)], [4.0], 0),
    ],
)
def test_what_is_begun_after_its_time_is_late(commands: list[Command], begun: list[float], late: int) -> None:
    assert account(commands, [Begun("drone", at, str(at)) for at in begun]).late == late
