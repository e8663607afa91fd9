"""Who is a candidate, and why another is not."""

from __future__ import annotations

from ua_fleet.fleet.skills import SkillModel
from ua_fleet.orchestrator.candidates import ResilienceSettings, TasksAhead, TaskToDo, ValueOf, rank_robots
from ua_fleet.resilience import Criterion
from ua_fleet.resilience.criteria import CriterionKind
from ua_fleet.scenario import FleetView, RobotView, Value, ValueUnknown
from ua_fleet.scenario.model import Task

SETTINGS = ResilienceSettings(((Criterion("availability", CriterionKind.BENEFIT, (0.0, 100.0)), TasksAhead()),), {})


def robot(name: str, *capacities: str, lacks: dict[str, str] | None = None) -> RobotView:
    return RobotView(name, frozenset(capacities), {"measure": SkillModel(1, "measure")}, lacks or {})


def test_a_robot_whose_sensor_is_pulled_out_is_no_candidate_and_says_so() -> None:
    why = {"temperature": "rover_pc.temperature is not there"}
    robots = [robot("rover", lacks=why), robot("drone", "temperature"), robot("arm")]
    fleet = FleetView({each.name: each for each in robots})
    task = TaskToDo(Task("0", 1, "t", "measure"), ("temperature",), {}, "")
    ranking = rank_robots(
        task, fleet, SETTINGS, unfit=lambda _robot, _needs: None, tasks_ahead=lambda _: 0, lookup=lambda _: 0.0
    )
    assert ranking.best == "drone"
    assert {left.robot: left.reason for left in ranking.excluded} == {
        "rover": "lacks the capacity temperature now: rover_pc.temperature is not there",
        "arm": "lacks the capacity temperature",
    }
    assert [each.name for each in fleet.able("measure", ["temperature"])] == ["drone"]
    assert [each.name for each in fleet.could("measure", ["temperature"])] == ["rover", "drone"]


BATTERY = Criterion("battery", CriterionKind.BENEFIT, (0.0, 100.0), "%", capacities=("mobile",))
REACH = Criterion("reach", CriterionKind.BENEFIT, (0.0, 2.0), "m", skills=("grasp",))
GO, GRASP = SkillModel(2, "go", ("mobile",)), SkillModel(3, "grasp", ("grab",))
FLEET = FleetView(
    {
        "rover": RobotView("rover", frozenset({"mobile", "grab"}), {"go": GO, "grasp": GRASP}),
        "ur3": RobotView("ur3", frozenset({"grab"}), {"grasp": GRASP}),
        "cart": RobotView("cart", frozenset({"mobile"}), {"go": GO}),
    }
)
VALUES: dict[str, Value] = {"rover.battery": 60.0, "rover.reach": 0.5, "ur3.reach": 1.5}


def look_up(name: str) -> Value:
    if name not in VALUES:
        raise ValueUnknown(f"there is no value {name!r}")
    return VALUES[name]


def test_a_criterion_counts_for_the_tasks_that_it_is_about_and_no_other() -> None:
    settings = ResilienceSettings(
        ((BATTERY, ValueOf("battery")), (REACH, ValueOf("reach"))), {("battery", "reach"): 3.0}
    )
    went = TaskToDo(Task("0", 1, "t", "go"), (), {}, "")
    ranking = rank_robots(
        went, FLEET, settings, unfit=lambda _robot, _needs: None, tasks_ahead=lambda _: 0, lookup=look_up
    )
    assert (ranking.weights.names, ranking.weights.weights) == (("battery",), (1.0,))
    assert [(place.robot, place.missing) for place in ranking.ranked] == [
        ("rover", ("",)),
        ("cart", ("battery is not known: there is no value 'cart.battery'; it counts as the worst, 0 %",)),
    ]
    grasped = TaskToDo(Task("0", 1, "t", "grasp"), ("grab",), {}, "")
    ranking = rank_robots(
        grasped, FLEET, settings, unfit=lambda _robot, _needs: None, tasks_ahead=lambda _: 0, lookup=look_up
    )
    assert ranking.weights.names == ("reach",)
    assert [place.robot for place in ranking.ranked] == ["ur3", "rover"]


def test_without_a_criterion_for_a_task_who_has_less_to_do_is_best() -> None:
    settings = ResilienceSettings(((REACH, ValueOf("reach")),), {})
    task = TaskToDo(Task("0", 1, "t", "go"), (), {}, "")
    ahead = {"rover": 2, "cart": 1, "ur3": 0}
    ranking = rank_robots(
        task, FLEET, settings, unfit=lambda _robot, _needs: None, tasks_ahead=ahead.__getitem__, lookup=look_up
    )
    assert [place.robot for place in ranking.ranked] == ["cart", "rover"]
    assert ranking.weights.names == ()


def test_a_robot_needs_what_its_own_skill_needs_whatever_the_task_names() -> None:
    """The gripper is not plugged in; the task names no capacity."""
    unplugged = {"grab": "ur3.gripper is not there"}
    robots = {**FLEET.robots, "ur3": RobotView("ur3", frozenset(), {"grasp": GRASP}, unplugged)}
    task = TaskToDo(Task("0", 1, "t", "grasp"), (), {}, "")
    ranking = rank_robots(
        task, FleetView(robots), SETTINGS, unfit=lambda _robot, _needs: None, tasks_ahead=lambda _: 0, lookup=look_up
    )
    assert [place.robot for place in ranking.ranked] == ["rover"]
    assert [left.reason for left in ranking.excluded if left.robot == "ur3"] == [
        "lacks the capacity grab now: ur3.gripper is not there"
    ]
