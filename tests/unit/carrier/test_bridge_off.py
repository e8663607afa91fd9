"""The fault of robots whose bridge a person has said to be off: it ends when that is heard, and ends no other one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest

from tests.unit.carrier.test_halts import (
    CFG,
    Asked,
    accept,
    adopted,
    begin,
    faults,
    records,
    service_of,
    take,
    world,
)
from tests.unit.carrier.test_stand_ins import Cell, hear_all
from ua_fleet.errors import StorageUnavailable
from ua_fleet.scenario.facts import TaskOutcome
from ua_fleet.storage.carried_records import CarriedRecords

__all__ = ["records", "world"]

OFF = ["b.bridge.off", "c.bridge.off"]


@pytest.fixture
def cell(tmp_path: Path, records: CarriedRecords, world: Asked) -> Cell:
    cell = adopted(tmp_path, records)
    assert sorted(faults(cell)) == OFF
    return cell


def end(cell: Cell, run: str = "run") -> None:
    side = cast("Any", cell.side)
    side._do(side._holder.take_end(run, "aborted", "enough", 0, cell.now))
    cell.go_on(0.1)


def restarted(cell: Cell, tmp_path: Path, records: CarriedRecords) -> Cell:
    again = Cell("cell", tmp_path, records, CFG)
    again.now = cell.now + 1
    again.go_on(0.1)
    return again


def test_it_ends_when_the_bridge_is_heard(cell: Cell) -> None:
    hear_all(cell)
    assert faults(cell) == []


def test_it_ends_when_the_bridge_is_heard_after_a_restart(cell: Cell, tmp_path: Path, records: CarriedRecords) -> None:
    end(cell)
    again = restarted(cell, tmp_path, records)
    take(again, "next")
    assert sorted(faults(again)) == OFF
    hear_all(again)
    assert faults(again) == []


def test_what_was_heard_before_does_not_end_it(cell: Cell) -> None:
    end(cell)
    for _ in range(30):
        cell.go_on(1.0)
        cell.subscriber.poll(cell.now)
    take(cell, "next")
    assert sorted(faults(cell)) == OFF


def test_its_end_ends_no_halt(cell: Cell, world: Asked) -> None:
    hear_all(cell)
    begin(cell, 1)
    ((robot, key),) = world.asked
    assert robot == "b"
    accept(cell, key)
    end(cell)
    for _ in range(12):
        hear_all(cell)
        cell.go_on(2.0)
    assert faults(cell) == ["b.not_halted"]
    cast("Any", cell.side)._engine.lose_bridge(301, "anna")
    assert sorted(faults(cell)) == ["b.bridge.off", "b.not_halted", "c.bridge.off"]
    hear_all(cell)
    assert faults(cell) == ["b.not_halted"]
    assert service_of(cell)._orchestrator.owes_halts


def has_failed(cell: Cell, key: str) -> None:
    accept(cell, key)
    service = service_of(cell)
    service._do(service._orchestrator.ended(key, TaskOutcome.FAILED, service._wall_s(), message="the gripper slipped"))
    cell.go_on(0.1)


def test_what_a_robot_has_failed_at_it_may_try_again_in_the_next_run(
    tmp_path: Path, records: CarriedRecords, world: Asked
) -> None:
    cell = Cell("cell", tmp_path, records, CFG)
    take(cell)
    hear_all(cell)
    begin(cell, 0)
    has_failed(cell, world.asked[0][1])
    service = service_of(cell)
    accept(cell, world.asked[1][1])
    service._do(service._orchestrator.ended(world.asked[1][1], TaskOutcome.DONE, service._wall_s()))
    cell.go_on(0.1)
    assert faults(cell) == ["a.skill"]
    take(cell, "other")
    end(cell)
    assert faults(cell) == ["a.skill"], "another run is open"
    end(cell, "other")
    assert faults(cell) == []
    again = restarted(cell, tmp_path, records)
    take(again, "next")
    hear_all(again)
    world.asked.clear()
    begin(again, 0, "next")
    assert [robot for robot, _ in world.asked] == ["a"]


def refuse_a_write(cell: Cell) -> None:
    """As where the engine could not write: the holder goes over all runs again."""
    cast("Any", cell.side)._holder.put_off("the disk is full", cell.now)
    cell.go_on(1.2)


def test_a_bridge_that_is_back_is_not_said_to_be_off_again(cell: Cell, tmp_path: Path, records: CarriedRecords) -> None:
    refuse_a_write(cell)
    assert sorted(faults(cell)) == OFF
    hear_all(cell)
    refuse_a_write(cell)
    assert faults(cell) == []
    again = restarted(cell, tmp_path, records)
    assert faults(again) == []


def test_it_is_said_again_while_the_bridge_is_off(cell: Cell, tmp_path: Path, records: CarriedRecords) -> None:
    assert sorted(faults(restarted(cell, tmp_path, records))) == OFF


def test_a_robot_that_is_at_work_for_a_bridge_that_is_back_goes_on(cell: Cell, world: Asked) -> None:
    hear_all(cell)
    begin(cell, 1)
    ((robot, key),) = world.asked
    accept(cell, key)
    hear_all(cell)
    refuse_a_write(cell)
    assert (robot, world.halted, world.asked[1:]) == ("b", [], [])


def test_that_a_bridge_is_back_is_written_down_later_where_the_disk_was_full(
    cell: Cell, tmp_path: Path, records: CarriedRecords, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_fact: object) -> None:
        raise StorageUnavailable("the disk is full")

    with monkeypatch.context() as patched:
        patched.setattr(records, "note", full)
        hear_all(cell)
        cell.go_on(2.2)
        assert faults(cell) == []
    cell.go_on(2.2)
    assert faults(restarted(cell, tmp_path, records)) == []
