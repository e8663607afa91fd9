# pyright: reportPrivateUsage=false
"""Faults that take away some capacities of a robot: what needs none of them goes on."""

from __future__ import annotations

import pytest

from tests.unit.orchestrator.world import World
from ua_fleet.orchestrator import Fault, FaultChanged, RunChanged
from ua_fleet.orchestrator.faults import Faults
from ua_fleet.resilience import DecisionMode, RankingChanged
from ua_fleet.scenario.facts import RobotReturned, TaskAssigned, decode_fact

GO_GRAB_GO = "".join(
    f"  - {{task: {task}, robot: ridgeback, skill: {skill}}}\n"
    for task, skill in (("approach", "go"), ("load", "grab"), ("back", "go"))
)


def assigned(world: World) -> list[tuple[str, str]]:
    facts = [said.fact for said in world.said if isinstance(said, RunChanged)]
    return [(fact.task, fact.robot) for fact in facts if isinstance(fact, TaskAssigned)]


def test_a_robot_that_cannot_drive_still_grabs_and_another_one_drives_for_it() -> None:
    world = World()
    world.start("a", GO_GRAB_GO)
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "announced", "the drive is hot", 0.5, ("mobile",)))
    world.go()
    assert assigned(world) == [
        ("approach", "ridgeback"),
        ("approach", "pioneer_1"),
        ("load", "ridgeback"),
        ("back", "pioneer_1"),
    ]
    assert len({change.event.decision_id for change in world.decisions()}) == 1, "nobody is asked twice"
    (ranking, *_) = [each.event.ranking for each in world.decisions() if isinstance(each.event, RankingChanged)]
    assert {left.robot: left.reason for left in ranking.excluded}["ridgeback"] == "lacks mobile: the drive is hot"


def test_what_needs_none_of_it_is_not_even_halted() -> None:
    world = World()
    world.start("a", "  - {task: load, robot: ridgeback, skill: grab}\n")
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "announced", "the drive is hot", 0.5, ("mobile",)))
    world.go()
    assert assigned(world) == [("load", "ridgeback")]
    assert not [line for line in world.log if "halted" in line]


def test_a_task_that_names_a_capacity_needs_it_also_where_its_skill_does_not() -> None:
    world = World()
    world.make.fault_raised("ridgeback", "robot", "the drive is hot", 0.0, ("mobile",))
    world.start("a", "  - {task: load, capacities: [grab, mobile], skill: grab}\n")
    world.go()
    assert assigned(world) == []
    assert any("ridgeback lacks mobile: the drive is hot" in line for line in world.log)


def test_a_robot_takes_back_what_it_can_again_and_no_more() -> None:
    world = World()
    world.start(
        "a",
        "".join(
            f"  - {{task: t{n}, robot: ridgeback, skill: {skill}}}\n"
            for n, skill in enumerate(("go", "grab", "go", "grab"))
        ),
    )
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "announced", "hot", 0.5, ("mobile",)))
    world.at(1.7, lambda: world.make.fault_raised("ridgeback", "stuck", "stuck", 1.7, ("grab",)))
    world.at(2.0, lambda: world.make.fault_cleared("ridgeback", "announced", 2.0))
    world.go()
    back = [
        said.fact.capacity
        for said in world.said
        if isinstance(said, RunChanged) and isinstance(said.fact, RobotReturned)
    ]
    assert back == ["mobile"]
    robots = dict(assigned(world))
    assert robots == {"t0": "pioneer_1", "t1": "ur3", "t2": "ridgeback", "t3": "ur3"}


def test_what_if_asks_for_each_task_by_what_it_needs() -> None:
    world = World(DecisionMode.OPERATOR)
    world.make.fault_raised("pioneer_1", "robot", "hot", 0.0, ("mobile",))
    world.start("a", GO_GRAB_GO)
    best = {one.task: one.ranking.best for one in world.make.what_if("ridgeback")[1]}
    assert best == {"approach": "pioneer_2", "load": "ur3", "back": "pioneer_2"}


def test_a_restart_knows_what_was_taken_and_who_stands_in() -> None:
    world = World()
    world.start("a", GO_GRAB_GO)
    world.at(0.5, lambda: world.make.fault_raised("ridgeback", "announced", "hot", 0.5, ("mobile",)))
    world.go(until_s=1.2)
    facts = [decode_fact(line) for _, line in world.journal]
    again = World()
    again.now = 1.2
    again.make.fault_raised("ridgeback", "announced", "hot", 0.5, ("mobile",))
    scenario = world.make._scenarios["a"]
    again.take(again.make.restore("a", scenario, facts, 1.2))
    again.go()
    assert assigned(again)[-2:] == [("load", "ridgeback"), ("back", "pioneer_1")] or assigned(again) == [
        ("load", "ridgeback"),
        ("back", "pioneer_1"),
    ]


@pytest.mark.parametrize(
    ("source", "first", "second", "both"),
    [
        ("robot", ("mobile",), ("grab",), ("mobile", "grab")),
        ("robot", ("mobile",), (), ()),
        ("skill", (), ("grab",), ()),
        ("announced", ("mobile",), ("grab",), ("grab",)),
        ("announced", ("mobile",), (), ()),
    ],
)
def test_what_is_raised_twice_adds_up_and_what_a_robot_announces_is_all_it_says(
    source: str, first: tuple[str, ...], second: tuple[str, ...], both: tuple[str, ...]
) -> None:
    faults = Faults()
    faults.raise_fault("r", source, "one", 0.0, first)
    faults.raise_fault("r", source, "two", 1.0, second)
    (fault,) = faults
    assert fault.capacities == both
    assert fault.reason == ("two" if source == "announced" else "one; two")
    assert fault.takes(("mobile",)) is (not both or "mobile" in both)


def test_the_alarm_tells_what_a_fault_takes_away() -> None:
    world = World()
    world.take(world.make.fault_raised("ridgeback", "announced", "hot", 0.0, ("mobile",)))
    (told,) = [said.fault for said in world.heard(FaultChanged) if isinstance(said, FaultChanged)]
    assert told == Fault("ridgeback.announced", "ridgeback", "announced", "hot", True, False, 0.0, "", ("mobile",))
