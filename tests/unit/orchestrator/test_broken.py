"""A run that meets a mistake of ours ends, and no other run with it."""

from __future__ import annotations

import pytest

from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator import (
    Orchestrator,
    Output,
    ResilienceSettings,
    RunBroken,
    RunChanged,
    TaskCancelled,
    TasksAhead,
)
from ua_fleet.resilience import Criterion, CriterionKind
from ua_fleet.scenario import FleetView, RobotView, Value, scenario_of
from ua_fleet.scenario.facts import Fact, RunEnded, RunOutcome

SETTINGS = ResilienceSettings(((Criterion("availability", CriterionKind.BENEFIT, (0, 100)), TasksAhead()),), {})
GO = SkillModel(1, "go", ("mobile",))
FLEET = FleetView({name: RobotView(name, frozenset({"mobile"}), {"go": GO}) for name in ("ned", "ted")})
HEAD = "version: 1\nname: s\nsteps:\n"
WORKING = scenario_of(
    f"{HEAD}  - parallel:\n      - {{task: t, robot: ned, skill: go}}\n      - {{wait: , until: bad > 1}}\n"
)
OTHER = scenario_of(f"{HEAD}  - {{task: u, robot: ted, skill: go}}\n")


class Broken(Exception):
    """A mistake that nobody has thought of."""


def ended(outputs: list[Output]) -> dict[str, RunEnded]:
    return {
        each.run_id: each.fact for each in outputs if isinstance(each, RunChanged) and isinstance(each.fact, RunEnded)
    }


@pytest.fixture
def journal() -> list[tuple[str, Fact]]:
    return []


def make(journal: list[tuple[str, Fact]]) -> tuple[Orchestrator, dict[str, Value]]:
    values: dict[str, Value] = {"bad": 0}

    def look_up(name: str) -> Value:
        if values[name] == "broken":
            raise Broken(name)
        return values[name]

    return Orchestrator(SETTINGS, FLEET, look_up, lambda run_id, fact: journal.append((run_id, fact))), values


def test_it_ends_failed_and_cancels_what_its_robots_are_at(journal: list[tuple[str, Fact]]) -> None:
    orchestrator, values = make(journal)
    orchestrator.start("a", WORKING, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    values["bad"] = "broken"
    outputs = orchestrator.poll(1.0)
    end = ended(outputs)["a"]
    assert (end.outcome, "Broken: bad" in end.reason) == (RunOutcome.FAILED, True)
    assert [each.robot for each in outputs if isinstance(each, TaskCancelled)] == ["ned"]
    assert [type(each.error) for each in outputs if isinstance(each, RunBroken)] == [Broken]
    assert list(orchestrator.runs) == ["b"]
    assert orchestrator.poll(2.0) == []


def test_it_does_not_stop_a_restart(journal: list[tuple[str, Fact]]) -> None:
    orchestrator, _ = make(journal)
    orchestrator.start("a", WORKING, {}, by="anna", now=0.0)
    orchestrator.start("b", OTHER, {}, by="anna", now=0.0)
    again, values = make([])
    values["bad"] = "broken"
    stored = [
        (name, scenario, [fact for run_id, fact in journal if run_id == name])
        for name, scenario in (("a", WORKING), ("b", OTHER))
    ]
    assert ended(again.restore_all(stored, 1.0)).keys() == {"a"}
    assert list(again.runs) == ["b"]
