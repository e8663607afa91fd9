# pyright: reportPrivateUsage=false
"""Faults of some capacities: how they are told, kept and shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.unit.operation.runs.world import World
from ua_fleet.config.schema import FleetConfig
from ua_fleet.nodes.alarms import Comment, alarm_fields, alarm_message
from ua_fleet.orchestrator import Fault
from ua_fleet.storage.run_journal import RunJournal
from ua_fleet.topics import Topic
from ua_fleet.values import BuiltinType, NodeId

CONFIG = FleetConfig.model_validate(
    {
        "version": 1,
        "pubsub": {"security": "none"},
        "bridges": {"cell": {"kind": "virtual", "space": 2, "status_id": 900}},
        "robots": {
            robot: {
                "bridge": "cell",
                "capacities": ["mobile", "grab"],
                "skill_status_id": 1200 + number,
                "fault_id": 1300 + number,
                "skills": {
                    "go": {"id": 1100 + number, "needs": ["mobile"], "timeout_s": 5},
                    "grab": {"id": 1110 + number, "needs": ["grab"], "timeout_s": 5},
                },
                "data": {"heat": {"id": 1000 + number, "type": "Double"}},
            }
            for number, robot in enumerate(("left", "right"))
        },
        "resilience": {
            "mode": "automatic",
            "faults": {"hot": {"robots": ["left", "right"], "when": "heat > 80", "capacities": ["mobile"]}},
        },
    }
)
ONE = "version: 1\nname: one\nsteps:\n  - {{task: t, skill: {skill}, robot: left}}\n"


def asked(world: World) -> list[str]:
    return [robot for robot, _, _ in world.robots.asked]


def test_a_device_that_comes_or_goes_is_a_part_of_what_a_robot_can_do(tmp_path: Path) -> None:
    """A robot is Faulted while its faults take away all that it can do: with a thermometer it can measure."""
    raw = CONFIG.model_dump(mode="json", exclude_unset=True)
    raw["robots"]["left"]["data"]["air"] = {"id": 1050, "type": "Double", "gives": ["temperature"]}
    world = World(tmp_path, config=FleetConfig.model_validate(raw))
    world.value(1300, "mobile, grab: no current", BuiltinType.STRING)
    assert world.faulted == {"left": True}
    for is_there in (True, False):
        world.capacities.source_changed(Topic(2, 2, 1050), is_there)
        world.service.fleet_changed()
        world.service.take_news()
        assert world.faulted == {"left": not is_there}


@pytest.mark.parametrize(
    ("said", "capacities", "reason"),
    [
        ("mobile: the drive is hot", ("mobile",), "the drive is hot"),
        ("mobile, grab: no current", ("mobile", "grab"), "no current"),
        ("fly: the rotor is broken", (), "fly: the rotor is broken"),
        ("mobile, fly: no current", (), "mobile, fly: no current"),
        ("error 12: mobile", (), "error 12: mobile"),
        ("Mobile: shouted", (), "Mobile: shouted"),
        (": nothing", (), ": nothing"),
        ("mobile:", ("mobile",), "mobile:"),
        ("mobile", (), "mobile"),
    ],
)
def test_a_text_may_begin_with_the_capacities_that_the_robot_has(
    said: str, capacities: tuple[str, ...], reason: str, tmp_path: Path
) -> None:
    world = World(tmp_path, config=CONFIG)
    world.value(1300, said, BuiltinType.STRING)
    world.service.fault_reports.raise_fault("right", said)
    world.pass_time(1)
    faults = {fault.id: (fault.capacities, fault.reason) for fault in world.service.faults}
    assert faults == {"left.announced": (capacities, reason), "right.robot": (capacities, reason)}


TOLD: dict[str, Callable[[World], None]] = {
    "announced": lambda world: world.value(1300, "mobile: hot", BuiltinType.STRING),
    "raised": lambda world: world.service.fault_reports.raise_fault("left", "mobile: hot"),
    "a condition": lambda world: world.value(1000, 90.0),
}


@pytest.mark.parametrize("told", TOLD)
@pytest.mark.parametrize(("skill", "robot"), [("go", "right"), ("grab", "left")])
def test_only_what_needs_it_goes_to_another_robot(told: str, skill: str, robot: str, tmp_path: Path) -> None:
    world = World(tmp_path, config=CONFIG)
    TOLD[told](world)
    world.pass_time(1)
    world.start(ONE.format(skill=skill))
    assert asked(world) == [robot]


def test_what_a_fault_takes_away_is_kept_over_a_restart(tmp_path: Path) -> None:
    world = World(tmp_path, config=CONFIG)
    world.service.fault_reports.raise_fault("left", "mobile: hot")
    world.journal.close()
    again = World(tmp_path, config=CONFIG)
    assert [fault.capacities for fault in again.service.faults] == [("mobile",)]
    again.start(ONE.format(skill="grab"))
    assert asked(again) == ["left"]
    again.service.fault_reports.raise_fault("left", "everything smokes")
    again.journal.close()
    last = World(tmp_path, again.robots, config=CONFIG)
    assert [(fault.capacities, fault.reason) for fault in last.service.faults] == [((), "hot; everything smokes")]


def test_a_fault_of_an_earlier_version_takes_everything_away(tmp_path: Path) -> None:
    with RunJournal(tmp_path / "runs.db") as journal:
        journal.write([], [Fault("left.robot", "left", "robot", "hot", True, False, 1.0, "", ("mobile",))])
        journal._database.commit(("DELETE FROM fault_capacities", ()))  # as the version before wrote it
    world = World(tmp_path, config=CONFIG)
    assert [fault.capacities for fault in world.service.faults] == [()]


def test_a_robot_is_faulted_when_nothing_is_left_that_it_can_do(tmp_path: Path) -> None:
    world = World(tmp_path, config=CONFIG)
    assert not world.service.fault_reports.can_do_nothing("left")
    world.value(1300, "mobile: hot", BuiltinType.STRING)
    world.pass_time(1)
    assert not world.service.fault_reports.can_do_nothing("left"), "it still grabs"
    world.service.fault_reports.raise_fault("left", "grab: stuck")
    assert world.service.fault_reports.can_do_nothing("left")
    world.service.fault_reports.clear_fault("left")
    assert not world.service.fault_reports.can_do_nothing("left")
    world.service.fault_reports.raise_fault("left", "it smokes")
    assert world.service.fault_reports.can_do_nothing("left")


def test_an_alarm_says_what_is_lost() -> None:
    fault = Fault("left.announced", "left", "announced", "hot", True, False, 1.0, "", ("mobile", "grab"))
    assert alarm_message(fault) == "left lacks mobile, grab: hot"
    fields = alarm_fields(fault, NodeId(2, "x"), b"e", Comment(), 1, 1)
    assert fields["Capacities"].value == ("mobile", "grab")
