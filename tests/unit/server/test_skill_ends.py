"""Executions as the log and the metrics tell them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest
import structlog
from structlog.testing import capture_logs

from tests.scraped import OPENMETRICS, Samples, samples
from ua_fleet.fleet.skills import SkillModel
from ua_fleet.monitoring import Monitor, ProcessKind
from ua_fleet.monitoring.metrics import EXECUTIONS, MOST_ROBOTS, MOST_SKILLS
from ua_fleet.operation.skills.executions import KnownExecution
from ua_fleet.operation.skills.program import Transition
from ua_fleet.operation.skills.tracker import SkillTransitioned
from ua_fleet.server import skill_ends as ends
from ua_fleet.server.skill_ends import OTHER, SkillEnds
from ua_fleet.skill.executions import ExecutionState
from ua_fleet.values import TICKS_PER_SECOND, NodeId, StatusCode

SECOND = TICKS_PER_SECOND
RUNNING = KnownExecution(bytes(16), ExecutionState.RUNNING, began=SECOND)
DONE = replace(RUNNING, state=ExecutionState.DONE, ended=4 * SECOND)
UNKNOWN = replace(RUNNING, state=ExecutionState.UNKNOWN, ended=2 * SECOND, message="nobody can tell")


def moved(move: Transition, execution: KnownExecution, robot: str = "arm", skill: str = "lift") -> SkillTransitioned:
    return SkillTransitioned(robot, SkillModel(1, skill), NodeId(2, 1), move, execution, 5 * SECOND)


def told(monitor: Monitor) -> Samples:
    return samples(monitor.exposition(OPENMETRICS)[0].decode())


@pytest.fixture
def monitor() -> Monitor:
    return Monitor(ProcessKind.SERVER)


@pytest.fixture
def made(monitor: Monitor) -> SkillEnds:
    made = SkillEnds(monitor)
    monitor.add(lambda: [EXECUTIONS.many(made.by_robot.items())])
    return made


def test_each_execution_has_two_lines_and_is_counted_once(made: SkillEnds, monitor: Monitor) -> None:
    with capture_logs() as lines:
        made.moved(moved(Transition.READY_TO_RUNNING, RUNNING))
        made.moved(moved(Transition.RUNNING_TO_SUSPENDED, replace(RUNNING, state=ExecutionState.SUSPENDED)))
        made.moved(moved(Transition.SUSPENDED_TO_RUNNING, RUNNING))
        made.moved(moved(Transition.RUNNING_TO_READY, DONE))
    assert [line["event"] for line in lines] == ["skill begins", "skill suspended", "skill goes on", "skill ended"]
    ids = {"robot": "arm", "skill": "lift", "execution_id": "00" * 16}
    assert lines[-1] == {"event": "skill ended", "log_level": "info", **ids, "outcome": "done", "seconds": 3.0}
    shown = told(monitor)
    assert shown["ua_fleet_skill_seconds_count", "done", "lift"] == 1
    assert shown["ua_fleet_skill_seconds_sum", "done", "lift"] == 3
    assert shown["ua_fleet_robot_executions_total", "done", "arm"] == 1


def test_what_is_found_out_later_counts_nothing(made: SkillEnds, monitor: Monitor) -> None:
    unknown = replace(UNKNOWN, status=StatusCode.UNCERTAIN)
    with capture_logs() as lines:
        made.moved(moved(Transition.RUNNING_TO_HALTED, unknown))
        made.moved(moved(Transition.HALTED_TO_READY, DONE))  # it was done after all
        made.moved(moved(Transition.HALTED_TO_READY, unknown))  # Reset
    (line,) = lines
    assert (line["log_level"], line["outcome"], line["reason"]) == ("warning", "unknown", "nobody can tell")
    assert line["status"] == "Uncertain"
    counts = {key: value for key, value in told(monitor).items() if key[0] == "ua_fleet_skill_seconds_count"}
    assert counts == {("ua_fleet_skill_seconds_count", "unknown", "lift"): 1}


def test_robots_and_skills_without_number_make_no_series_without_number(
    made: SkillEnds, monitor: Monitor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ends, "_log", structlog.wrap_logger(None, processors=[_nothing]))
    for number in range(MOST_ROBOTS + 100):
        made.moved(moved(Transition.RUNNING_TO_READY, DONE, f"robot{number}", f"skill{number}"))
    shown = told(monitor)
    skills = {key[2] for key in shown if key[0] == "ua_fleet_skill_seconds_count"}
    assert len(skills) == MOST_SKILLS + 1
    assert shown["ua_fleet_skill_seconds_count", "done", OTHER] == MOST_ROBOTS + 100 - MOST_SKILLS
    assert sum(key[0] == "ua_fleet_robot_executions_total" for key in shown) == MOST_ROBOTS
    assert made.names_left_out == MOST_ROBOTS + 100 - MOST_SKILLS


def _nothing(*_: object) -> str:
    raise structlog.DropEvent


def test_all_transitions_of_an_end_are_told_apart() -> None:
    """An execution that began and ended between two messages has two transitions, of which one is its end."""
    made = SkillEnds(Monitor(ProcessKind.SERVER))
    with capture_logs() as lines:
        for move, execution in itertools.product((Transition.READY_TO_RUNNING, Transition.RUNNING_TO_READY), (DONE,)):
            made.moved(moved(move, execution))
    assert [line["event"] for line in lines] == ["skill begins", "skill ended"]
