"""Runs as people see them."""

from __future__ import annotations

import json
from math import inf

import pytest

from tests.unit.operation.runs.test_decision_words import RANKING
from ua_fleet.operation.runs.records import DecisionRecord, RunRecord
from ua_fleet.orchestrator import DecisionChanged
from ua_fleet.resilience import Aborted, RankingChanged
from ua_fleet.scenario.facts import (
    Fact,
    Replaced,
    ReplacementWanted,
    RunCreated,
    StepEnded,
    StepState,
    TaskAnswered,
    TaskAssigned,
    TaskOutcome,
    TaskOver,
    Then,
    decode_fact,
    encode_fact,
)

CREATED = RunCreated(1.0, "r", "version: 1\nname: s\nsteps:\n  - {task: fetch, robot: ned, skill: go}\n")


def rows_of(*facts: Fact) -> list[tuple[str, str, str, str, str]]:
    record = RunRecord.of("r", [CREATED, *facts])
    return [(row.task, row.robot, row.skill, row.state, row.message) for row in record.rows()]


def test_a_task_that_has_got_no_robot_is_shown_with_its_name_and_why() -> None:
    wanted = ReplacementWanted(2.0, "0", "ned", "ned is stuck", "fetch", "go")
    assert decode_fact(encode_fact(wanted)) == wanted
    assert rows_of(wanted) == [("fetch", "ned", "go", "replacing", "ned is stuck")]
    begun = TaskAssigned(3.0, "0", "fetch", 1, "ur3", "e", "go")
    assert rows_of(wanted, Replaced(2.5, "0", "ned", "ur3", "anna"), begun) == [
        ("fetch", "ur3", "go", "assigned", "ned is stuck")
    ]


def test_a_journal_of_an_earlier_version_is_read() -> None:
    wanted = json.loads(encode_fact(ReplacementWanted(2.0, "0", "ned", "ned is stuck", "fetch", "go")))
    del wanted["task"], wanted["skill"]
    (row,) = rows_of(decode_fact(json.dumps(wanted)))
    assert row == ("", "ned", "", "replacing", "ned is stuck")


def times_of(*facts: Fact) -> tuple[float | None, float | None]:
    """When the one task began and ended, after the facts have been in a journal."""
    (row,) = RunRecord.of("r", [decode_fact(encode_fact(fact)) for fact in (CREATED, *facts)]).rows()
    return row.begun, row.ended


def assigned(at: float, attempt: int = 1, robot: str = "ned") -> TaskAssigned:
    return TaskAssigned(at, "0", "fetch", attempt, robot, f"e{attempt}", "go")


def over(at: float, then: Then, attempt: int = 1) -> TaskOver:
    return TaskOver(at, "0", attempt, TaskOutcome.UNKNOWN, then)


def test_a_task_has_the_times_of_its_last_attempt() -> None:
    assert times_of(assigned(2.0)) == (2.0, None)
    assert times_of(assigned(2.0), over(3.0, Then.DONE)) == (2.0, 3.0)
    assert times_of(assigned(2.0), over(3.0, Then.RETRY)) == (2.0, 3.0)
    assert times_of(assigned(2.0), over(3.0, Then.RETRY), assigned(4.0, 2)) == (4.0, None)
    assert times_of(assigned(2.0), StepEnded(5.0, "0", StepState.FAILED, "it was aborted")) == (2.0, 5.0)


def test_an_attempt_of_which_nobody_knows_whether_it_is_over_has_no_end() -> None:
    unknown: list[Fact] = [assigned(2.0), over(3.0, Then.ASK)]
    assert times_of(*unknown) == (2.0, None)
    assert times_of(*unknown, TaskAnswered(9.0, "0", Then.DONE, "anna")) == (2.0, 9.0)
    assert times_of(*unknown, TaskAnswered(9.0, "0", Then.AWAIT, "anna")) == (2.0, None)


def test_another_robot_has_not_begun_what_the_first_one_began() -> None:
    wanted = ReplacementWanted(4.0, "0", "ned", "ned is stuck", "fetch", "go")
    taken = Replaced(5.0, "0", "ned", "ur3", "anna")
    replaced: list[Fact] = [assigned(2.0), over(3.0, Then.REPLACE), wanted, taken]
    assert times_of(*replaced) == (None, None)
    assert times_of(*replaced, assigned(6.0, 2, "ur3")) == (6.0, None)


def test_a_run_has_the_text_that_it_began_with() -> None:
    assert RunRecord.of("r", [CREATED]).text == CREATED.text


def test_a_decision_says_since_when_and_until_when_it_is_open() -> None:
    ranked, ended = RankingChanged("r.0", RANKING), Aborted("r.0", "over")

    def changed(event: RankingChanged | Aborted, until: float | None) -> DecisionChanged:
        return DecisionChanged("r", "0", "fetch", "ned", "stuck", event, until)

    record = DecisionRecord.of(changed(ranked, 70.0))
    record.apply(changed(ranked, 70.0), 10.0)
    record.apply(changed(ranked, 75.0), 20.0)
    assert (record.opened, record.deadline) == (10.0, 75.0), "another ranking opens nothing anew"
    record.apply(changed(ended, None), 30.0)
    assert (record.opened, record.deadline) == (10.0, None)
    record.apply(changed(ranked, -inf), 40.0)
    assert (record.opened, record.deadline) == (40.0, None), "opened again, and decided at once"


@pytest.mark.parametrize("until", [inf, -inf, 1e12])
def test_a_decision_says_no_time_after_the_last_one(until: float) -> None:
    record = DecisionRecord("r.0", "r", "0", "fetch", "ned", "stuck")
    record.apply(DecisionChanged("r", "0", "fetch", "ned", "stuck", RankingChanged("r.0", RANKING), until), 5.0)
    assert record.deadline is None
    assert "waits until" not in record.awaited(is_asked=False, until=until)
    assert record.awaited(is_asked=False, until=2e11).endswith("; waits until 8307-10-01 19:33:20 UTC")
