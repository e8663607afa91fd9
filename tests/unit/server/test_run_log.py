"""Runs, faults and decisions as the log tells them."""

from __future__ import annotations

from structlog.testing import capture_logs

from ua_fleet.orchestrator import (
    DecisionChanged,
    Fault,
    FaultChange,
    FaultChanged,
    OperatorAsked,
    Output,
    RunChanged,
    TaskWaiting,
)
from ua_fleet.resilience import Aborted, Ranking, RankingChanged, ReplacementChosen, Synthesis, Weights
from ua_fleet.scenario.effects import TaskWaits
from ua_fleet.scenario.facts import Fact, RunEnded, RunOutcome, TaskAssigned, TaskOutcome, TaskOver, Then
from ua_fleet.server.run_log import RunLog

RUN = "20261121-101500-3fa2b1"
ASSIGNED = TaskAssigned(1.0, "0", "weld", 1, "arm", "e1", "work")
IDS = {"run_id": RUN, "step": "0", "task": "weld", "robot": "arm", "skill": "work", "execution_id": "e1"}
EMPTY = Ranking(Weights((), (), 0.0, 0.0), Synthesis.DISTRIBUTIVE, (), ())


def said(log: RunLog, *outputs: Output | Fact) -> list[dict[str, object]]:
    """The lines that follow from what happens; facts are of the run."""
    with capture_logs() as lines:
        for output in outputs:
            log.take(output if isinstance(output, Output) else RunChanged(RUN, output))
    return [dict(line) for line in lines]


def test_a_task_that_fails_says_what_follows() -> None:
    over = TaskOver(2.0, "0", 1, TaskOutcome.FAILED, Then.RETRY, "it slipped")
    begun, ended = said(RunLog(), ASSIGNED, over)
    assert begun == {"event": "task begins", "log_level": "info", **IDS, "attempt": 1}
    outcome = {"outcome": "failed", "then": "retry", "reason": "it slipped"}
    assert ended == {"event": "task ended", "log_level": "warning", **IDS, **outcome}


def test_a_task_that_waits_says_for_what() -> None:
    reason = "arm does task weld of run other"
    waiting = TaskWaiting(RUN, TaskWaits("0", "weld", "join", "arm", reason))
    over = TaskWaiting(RUN, TaskWaits("0", "weld", "join", "arm", ""))
    (line,) = said(RunLog(), waiting, over)
    ids = {"run_id": RUN, "step": "0", "task": "weld", "skill": "join", "robot": "arm"}
    assert line == {"event": "task waits", "log_level": "info", **ids, "reason": reason}


def test_ended_runs_are_counted_by_outcome() -> None:
    log = RunLog()
    lines = said(log, RunEnded(1.0, RunOutcome.DONE), RunEnded(1.0, RunOutcome.FAILED, "too hot"))
    assert log.ended == {RunOutcome.DONE: 1, RunOutcome.FAILED: 1}
    assert [(line["log_level"], line["reason"]) for line in lines] == [("info", ""), ("warning", "too hot")]


def decision(event: RankingChanged | ReplacementChosen | Aborted) -> DecisionChanged:
    return DecisionChanged(RUN, "0", "weld", "arm", "it is silent", event)


def test_a_decision_has_a_line_when_it_is_open_and_one_when_it_is_made() -> None:
    ranked = decision(RankingChanged("d1", EMPTY))
    chosen = decision(ReplacementChosen("d1", "other", "anna", EMPTY))
    log = RunLog()
    first, second = said(log, ranked, ranked, chosen)
    of = {"run_id": RUN, "step": "0", "task": "weld", "decision_id": "d1"}
    assert first == {
        "event": "a replacement has to be chosen",
        "log_level": "warning",
        **of,
        "robot": "arm",
        "reason": "it is silent",
    }
    assert second == {
        "event": "replacement chosen",
        "log_level": "info",
        **of,
        "robot": "other",
        "instead_of": "arm",
        "by": "anna",
    }
    (given_up,) = said(log, decision(Aborted("d2", "no operator chose in time")))
    assert (given_up["event"], given_up["reason"]) == ("no replacement", "no operator chose in time")


def test_a_silent_robot_has_one_line_and_that_is_not_its_fault() -> None:
    def changed(source: str, change: FaultChange) -> FaultChanged:
        return FaultChanged(Fault(f"arm.{source}", "arm", source, "broken", True, False, 1.0), change)

    log = RunLog()
    assert said(log, changed("silent", FaultChange.RAISED), changed("silent", FaultChange.CLEARED)) == []
    lines = said(
        log,
        changed("skill", FaultChange.RAISED),
        changed("skill", FaultChange.REASON_CHANGED),
        changed("skill", FaultChange.ACKNOWLEDGED),
        changed("skill", FaultChange.CLEARED),
    )
    assert [(line["event"], line["robot"]) for line in lines] == [
        ("robot has a fault", "arm"),
        ("fault is over", "arm"),
    ]


def test_a_question_to_an_operator_has_its_ids() -> None:
    (line,) = said(RunLog(), OperatorAsked(RUN, "0", "weld", "arm", "was it done?", "work", "e1"))
    assert line["log_level"] == "warning"
    assert (line["run_id"], line["execution_id"], line["question"]) == (RUN, "e1", "was it done?")
