"""What outlives a full disk, a restart and the end of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.operation.runs.world import CONFIG, IMMEDIATE, ONE, World
from ua_fleet.config.resilience_schema import ModeName
from ua_fleet.errors import StorageUnavailable
from ua_fleet.orchestrator import DecisionChanged, FaultFound
from ua_fleet.resilience import Aborted
from ua_fleet.scenario.consequences import SETTLE_S
from ua_fleet.values import BuiltinType


def test_a_run_that_cannot_be_written_down_is_none(tmp_path: Path) -> None:
    """Whoever is told so may start it again, and must not get two."""
    world = World(tmp_path)
    world.journal.fails = True
    for _ in range(2):
        with pytest.raises(StorageUnavailable):
            world.start()
    assert world.service.run_ids == []
    world.journal.fails = False
    world.pass_time(5)
    assert (world.robots.asked, world.said) == ([], [])
    world.start()
    assert [robot for robot, _, _ in world.robots.asked] == ["left"], "it was given back"


def test_what_cannot_be_written_is_not_carried_out_until_it_is(tmp_path: Path) -> None:
    world = World(tmp_path)
    run_id = world.start(f"{ONE}  - {{task: b, skill: grab, robot: right}}\n")
    world.journal.fails = True
    world.service.concluded(world.robots.asked[0][2], IMMEDIATE)
    with pytest.raises(StorageUnavailable):
        world.service.runs.pause(run_id, "anna")
    world.pass_time(5)
    assert [robot for robot, _, _ in world.robots.asked] == ["left"]
    world.journal.fails = False
    world.pass_time(2)
    assert [robot for robot, _, _ in world.robots.asked] == ["left", "right"]


def test_a_battery_that_was_low_before_the_restart_is_seen_to_be_low_again(tmp_path: Path) -> None:
    world = World(tmp_path)
    for percent in (15.0, 50.0):
        world.value(1000, percent)
        world.pass_time(1.0)
    assert world.faults() == ["left.battery_low RAISED", "left.battery_low CLEARED"]
    world.journal.close()
    again = World(tmp_path)
    again.said.clear()
    again.start()
    for percent in (50.0, 15.0):
        again.value(1000, percent)
        again.pass_time(1.0)
    assert "left.battery_low RAISED" in again.faults()


RAISED_BEFORE = ("robot", "skill", "not_halted", "announced", "alarm.battery")


@pytest.mark.parametrize(
    "faults",
    [
        {},
        {"battery_low": {"robots": ["right"], "when": "battery < 20"}},
        {"empty": {"robots": ["left"], "when": "battery < 5"}},
    ],
    ids=["gone", "not of this robot", "renamed"],
)
def test_a_fault_whose_condition_is_gone_ends_at_the_start(tmp_path: Path, faults: dict[str, object]) -> None:
    world = World(tmp_path)
    world.value(1000, 15.0)
    world.pass_time(1.0)
    world.journal.close()
    resilience = CONFIG.resilience.model_validate({"mode": "automatic", "faults": faults})
    again = World(tmp_path, config=CONFIG.model_copy(update={"resilience": resilience}))
    assert again.faults() == ["left.battery_low RAISED", "left.battery_low CLEARED"], "it is told as other ends"
    assert [fault.id for fault in again.service.faults] == ["left.battery_low"], "nobody has acknowledged it"
    again.start()
    assert [robot for robot, _, _ in again.robots.asked] == ["left"]
    again.service.fault_reports.acknowledge("left.battery_low", "anna")
    again.journal.close()
    assert World(tmp_path).faults() == [], "that it is over is written down"


def test_faults_that_no_condition_found_stay(tmp_path: Path) -> None:
    world = World(tmp_path)
    world.service.news.alarms_found([FaultFound("left", source, True, "it was so") for source in RAISED_BEFORE])
    world.pass_time(1.0)
    world.journal.close()
    resilience = CONFIG.resilience.model_validate({"mode": "automatic"})
    again = World(tmp_path, config=CONFIG.model_copy(update={"resilience": resilience}), heard=())
    active = [fault.source for fault in again.service.faults if fault.active]
    assert sorted(active) == sorted(RAISED_BEFORE)


def test_a_decision_ends_with_its_run(tmp_path: Path) -> None:
    operator = CONFIG.resilience.model_copy(update={"mode": ModeName.OPERATOR})
    world = World(tmp_path, config=CONFIG.model_copy(update={"resilience": operator}))
    run_id = world.start()
    world.value(1300, "stuck", BuiltinType.STRING)
    world.pass_time(SETTLE_S)
    assert world.service.open_decisions == 1
    world.service.runs.abort(run_id, "", "anna")
    world.pass_time(20.0)
    events = [output.event for output in world.said if isinstance(output, DecisionChanged)]
    assert isinstance(events[-1], Aborted)
    assert (events[-1].reason, world.service.open_decisions) == ("the run has ended", 0)
