"""The course of the nine tasks, fed with what a server tells at chosen times."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from ua_demo.talkrobots.course import TASKS, Course, ranking_lines

from ua_fleet.client import DecisionInfo, DecisionTold, FaultTold, RankedRobot, RankingInfo, RunInfo, RunTold, StepTold

START = 1000.0
SPEED = 10.0
RANKING = RankingInfo(
    criteria=("battery", "distance"),
    weights=(0.25, 0.75),
    consistency_ratio=0.01,
    ranked=(
        RankedRobot("near", 0.6, (70.0, 1.0), (0.4, 0.667)),
        RankedRobot("far", 0.4, (90.0, 2.0), (0.6, 0.333)),
    ),
    excluded=(("arm", "lacks the capacity mobile"),),
)


def at(seconds: float) -> float:
    return START + seconds / SPEED


def begun(task: str, robot: str, seconds: float) -> StepTold:
    return StepTold("run", "TaskAssigned", task, robot, "go", "", {"arguments": {"to": "dock"}}, at(seconds))


def over(task: str, robot: str, seconds: float, outcome: str = "done") -> StepTold:
    detail = {"results": {"way": 1.23456}, "message": ""}
    return StepTold("run", "TaskOver", task, robot, "go", outcome, detail, at(seconds))


def decision(state: str, seconds: float, chosen: str = "", ranking: RankingInfo = RANKING) -> DecisionTold:
    return DecisionTold("run", "run.3", state, "go", "rover", "stuck", chosen, "anna", ranking, at(seconds))


def run(state: str, seconds: float, message: str = "") -> RunTold:
    return RunTold("run", "nine_tasks", state, message, at(seconds))


@pytest.fixture
def course() -> Course:
    made = Course("run", SPEED, {"distance": "m"})
    made.take(run("running", 0))
    return made


def test_nine_tasks_each_done_once_are_a_success(course: Course) -> None:
    for number in range(TASKS):
        course.take(begun(f"t{number}", "rover", number))
        course.take(over(f"t{number}", "rover", number + 0.5))
    assert course.problems == ["the run has not succeeded: None"], "it goes on"
    course.take(run("done", 10))
    assert course.problems == []
    assert course.elapsed_s == pytest.approx(10, abs=0.01)
    rows = course.report()["tasks"]
    assert len(rows) == TASKS
    row = {"task": "t1", "robot": "rover", "skill": "go", "state": "done", "started_s": 1.0, "ended_s": 1.5}
    assert rows[1] == pytest.approx(row)
    assert course.report()["fault"] is None


def test_a_task_that_is_missing_or_done_twice_is_a_problem(course: Course) -> None:
    for seconds in (1, 2):
        course.take(begun("t0", "rover", seconds))
        course.take(over("t0", "rover", seconds + 0.5))
    course.take(run("done", 10))
    assert course.problems == ["t0 was done 2 times", "1 of 9 tasks were done"]


def test_a_run_that_fails_says_why(course: Course) -> None:
    lines = course.take(run("failed", 10, "nine_tasks run: failed: no robot can do go"))
    assert lines == ["  10.00 s  scenario           failed: no robot can do go"]
    assert course.problems == ["the run has not succeeded: failed: no robot can do go"]


def test_other_runs_are_left_alone(course: Course) -> None:
    assert course.take(RunTold("other", "nine_tasks", "failed", "", at(3))) == []
    assert course.outcome is None


def test_a_fault_its_ranking_and_the_choice(course: Course) -> None:
    course.take(begun("go", "rover", 1))
    fault = FaultTold("rover.announced", "rover", "announced", "stuck", True, False, at(2))
    assert course.take(fault) == ["   2.00 s  rover              FAULT: stuck"]
    course.take(over("go", "rover", 2, "fault"))
    asked = course.take(decision("open", 2.5))
    assert asked[0] == "   2.50 s  resilience         who takes over go from rover?"
    assert asked[1:] == ranking_lines(RANKING, {"distance": "m"})
    course.take(decision("chosen", 3, "near"))
    course.take(begun("go", "near", 3.5))
    course.take(over("go", "near", 4))
    report = course.report()
    assert report["tasks"][0]["robot"] == "near"
    assert report["tasks"][0]["state"] == "done"
    assert report["fault"] == {
        "robot": "rover",
        "task": "go",
        "detected_s": pytest.approx(2),
        "replacement": "near",
        "decided_s": pytest.approx(3),
        "ranking": [
            {"robot": "near", "score": 0.6, "per_criterion": {"battery": 0.4, "distance": 0.667}},
            {"robot": "far", "score": 0.4, "per_criterion": {"battery": 0.6, "distance": 0.333}},
        ],
        "consistency_ratio": 0.01,
    }
    ended = FaultTold("rover.announced", "rover", "announced", "stuck", False, False, at(5))
    assert course.take(ended) == ["   5.00 s  rover              is repaired (it was: stuck)"]


def test_a_fault_of_some_capacities_says_which(course: Course) -> None:
    fault = FaultTold("rover.announced", "rover", "announced", "stuck", True, False, at(2), ("mobile", "grab"))
    assert course.take(fault) == ["   2.00 s  rover              FAULT, not mobile, not grab any more: stuck"]


def test_a_ranking_is_printed_again_only_when_its_order_changes(course: Course) -> None:
    assert course.take(decision("open", 1))
    nearer = RankingInfo(
        RANKING.criteria, RANKING.weights, RANKING.consistency_ratio, RANKING.ranked[::-1], RANKING.excluded
    )
    assert course.take(decision("open", 2)) == []
    assert course.take(decision("open", 3, ranking=nearer))


def test_a_ranking_explains_itself() -> None:
    assert [line.strip() for line in ranking_lines(RANKING, {"distance": "m"})] == [
        "battery      distance [m]  score",
        "weight  0.250        0.750",
        "near    70 -> 0.400  1 -> 0.667    0.600",
        "far     90 -> 0.600  2 -> 0.333    0.400",
        "consistency ratio of the judgements: 0.010 (at most 0.1)",
        "no candidate: arm lacks the capacity mobile",
    ]


def stands(state: str, **tasks: tuple[str, str]) -> RunInfo:
    """A run whose tasks have these robots and states."""
    robots, states = zip(*tasks.values(), strict=True)
    started = datetime.fromtimestamp(START, UTC).isoformat()
    nothing = ("{}",) * len(tasks)
    return RunInfo("run", state, "nine_tasks", started, "anna", "", tuple(tasks), robots, states, nothing, nothing)


def test_what_happened_unseen_is_caught_up_with_once(course: Course) -> None:
    course.take(begun("fetch", "rover", 1))
    seen = stands("running", fetch=("rover", "done"), go=("spare", "accepted"), load=("", "wanted"))
    assert course.catch_up(seen, [], at(20)) == [
        "  20.00 s  rover              fetch is done",
        "  20.00 s  spare              is at go",
    ]
    assert course.catch_up(seen, [], at(30)) == []
    course.take(over("go", "spare", 31))
    rows = course.report()["tasks"]
    assert [(row["task"], row["robot"], row["state"]) for row in rows] == [
        ("fetch", "rover", "done"),
        ("go", "spare", "done"),
    ]
    assert [row["ended_s"] for row in rows] == pytest.approx([20, 31])


def test_a_run_that_ended_unseen_has_ended(course: Course) -> None:
    tasks = {f"t{number}": ("rover", "done") for number in range(TASKS)}
    lines = course.catch_up(stands("done", **tasks), [], at(50))
    assert lines[-1] == "  50.00 s  scenario           done"
    assert (course.outcome, course.problems) == ("done", [])


def test_a_run_is_followed_from_its_middle() -> None:
    course = Course("run", SPEED, {})
    course.catch_up(stands("running", fetch=("rover", "accepted")), [], at(5))
    assert course.started_at == START
    assert course.rows["fetch"].started_s == pytest.approx(5)


def test_only_a_fault_that_was_replaced_stands_in_the_report(course: Course) -> None:
    early = Course("run", SPEED, {})
    quiet = FaultTold("quiet", "far", "far", "it is not heard", active=True, acknowledged=False, at=START - 50)
    assert early.take(quiet) == ["   0.00 s  far                FAULT: it is not heard"]
    early.take(run("running", 0))
    assert early.report()["fault"] is None, "it was before the run"

    for robot, seconds in (("far", 1), ("rover", 2)):
        course.take(FaultTold(robot, robot, robot, "stuck", active=True, acknowledged=False, at=at(seconds)))
    course.take(decision("chosen", 3, "near"))
    fault = course.report()["fault"]
    assert (fault["robot"], fault["replacement"], fault["detected_s"]) == ("rover", "near", pytest.approx(2))


def test_a_replacement_that_was_not_told_stands_in_the_report(course: Course) -> None:
    def info(decision_id: str, state: str = "chosen") -> DecisionInfo:
        names, scores = ("near", "far"), (0.6, 0.4)
        return DecisionInfo(
            decision_id, state, "go", "rover", "stuck", "near", "anna", names, scores, ("arm",), ("no",), 0.01
        )

    decisions = [info("other.1"), info("run.2", "open"), info("run.3")]
    now = stands("running", go=("near", "accepted"))
    assert course.catch_up(now, decisions, at(9)) == [
        "   9.00 s  near               is at go",
        "   9.00 s  resilience         near has taken over go from rover, chosen by anna",
    ]
    assert course.catch_up(now, decisions, at(10)) == []
    fault = course.report()["fault"]
    assert (fault["robot"], fault["task"], fault["replacement"]) == ("rover", "go", "near")
    assert [(place["robot"], place["score"]) for place in fault["ranking"]] == [("near", 0.6), ("far", 0.4)]
