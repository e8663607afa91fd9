"""Who is a candidate, and why another is not."""

from __future__ import annotations

from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator.candidates import ResilienceSettings, TasksAhead, TaskToDo, rank_robots
from ua_fleet.resilience import Criterion
from ua_fleet.resilience.criteria import CriterionKind
from ua_fleet.scenario import FleetView, RobotView
from ua_fleet.scenario.model import Task

SETTINGS = ResilienceSettings(((Criterion("availability", CriterionKind.BENEFIT, (0.0, 100.0)), TasksAhead()),), {})


def robot(name: str, *capacities: str, lacks: dict[str, str] | None = None) -> RobotView:
    return RobotView(name, frozenset(capacities), {"measure": SkillModel(1, "measure")}, lacks or {})


def test_a_robot_whose_sensor_is_pulled_out_is_no_candidate_and_says_so() -> None:
    why = {"temperature": "rover_pc.temperature is not there"}
    robots = [robot("rover", lacks=why), robot("drone", "temperature"), robot("arm")]
    fleet = FleetView({each.name: each for each in robots})
    task = TaskToDo(Task("0", 1, "t", "measure"), ("temperature",), {}, "")
    ranking = rank_robots(task, fleet, SETTINGS, unfit={}, tasks_ahead=lambda _: 0, lookup=lambda _: 0.0)
    assert ranking.best == "drone"
    assert {left.robot: left.reason for left in ranking.excluded} == {
        "rover": "has not the capacity temperature now: rover_pc.temperature is not there",
        "arm": "has not the capacity temperature",
    }
    assert [each.name for each in fleet.able("measure", ["temperature"])] == ["drone"]
    assert [each.name for each in fleet.could("measure", ["temperature"])] == ["rover", "drone"]
