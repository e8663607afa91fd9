"""What was told to stop by a bridge's engine is told again until it says that it has, whether or not a run is open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from tests.unit.carrier.test_stand_ins import MODEL, PLAN, Cell, hear_all
from ua_fleet.carrying import SegmentRound, Token, encode_part, encode_token, parts_of
from ua_fleet.carrying.adoption import Adoption, encode_adoption, plan_without
from ua_fleet.carrying.facts import SegmentBegun, TokenTaken
from ua_fleet.config.schema import FleetConfig
from ua_fleet.operation.skills.commands import SkillCommands
from ua_fleet.storage.carried_records import CarriedRecords

CFG = FleetConfig.model_validate(MODEL)
HEIR = parts_of(plan_without(PLAN, 301, 300), "run", "made", {}, "eva", adopt_after_s=10.0, epoch=2)[300]


class Asked:
    """In the place of robots: what they are asked and told to stop. They say nothing by themselves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[tuple[str, str]] = []
        self.halted: list[tuple[str, str]] = []
        self.known: set[bytes] = set()
        for name in ("request", "halt", "known_outcome", "prepare", "inquire"):
            monkeypatch.setattr(SkillCommands, name, getattr(self, name))

    def request(self, *asked: Any) -> None:
        _topic, robot, _skill, _arguments, _timeout, key = asked
        self.asked.append((robot, key.hex()))
        self.known.add(key)

    def halt(self, _topic: object, robot: str, key: bytes) -> None:
        self.halted.append((robot, key.hex()))

    def prepare(self, *_asked: object) -> None:
        pass

    def inquire(self, _key: bytes) -> None:
        pass

    def known_outcome(self, key: bytes) -> None:
        if key not in self.known:
            raise KeyError(key)


def take(cell: Cell, run: str = "run") -> None:
    part = parts_of(PLAN, run, "made", {}, "eva", adopt_after_s=10.0)[300]
    cast("Any", cell.side)._take_part(encode_part(part), cell.now)
    cell.go_on(0.1)


def adopt(cell: Cell) -> None:
    """A person says that the bridge of b and c is off, and that this one goes on in its place."""
    content = encode_adoption(Adoption(HEIR, (301,), "anna"), encode_part(HEIR))
    cast("Any", cell.side)._take_adoption(content, cell.now)
    cell.go_on(0.1)


def begin(cell: Cell, number: int, run: str = "run") -> None:
    side = cast("Any", cell.side)
    part = side._holder.runs[run].part
    token = encode_token(Token(run, part.plan_hash, part.epoch, number, 0), ())
    side._holder._note(TokenTaken(cell.now, run, token.hex(), 0))
    side._holder._note(SegmentBegun(cell.now, run, number))
    side._do([side._holder.runs[run].begin(SegmentRound(number))])
    cell.go_on(0.1)


def service_of(cell: Cell) -> Any:
    return cast("Any", cell.side)._engine_now(cell.now)._service


def accept(cell: Cell, key: str) -> None:
    service = service_of(cell)
    service._do(service._orchestrator.accepted(key, service._wall_s()))


def faults(cell: Cell) -> list[str]:
    return [fault.id for fault in service_of(cell).faults if fault.active and fault.source != "silent"]


def told_at(cell: Cell, world: Asked, for_s: float) -> list[int]:
    """When robots are told to stop, in seconds from now."""
    start, told, seen = cell.now, list[int](), len(world.halted)
    while cell.now < start + for_s:
        told += [round(cell.now - start)] * (len(world.halted) - seen)
        seen = len(world.halted)
        cell.go_on(1.0)
    return told


def adopted(tmp_path: Path, records: CarriedRecords) -> Cell:
    """A bridge that goes on in the place of the one of b and c."""
    cell = Cell("cell", tmp_path, records, CFG)
    take(cell)
    hear_all(cell)
    adopt(cell)
    return cell


@pytest.fixture
def records(tmp_path: Path) -> Iterator[CarriedRecords]:
    with CarriedRecords(tmp_path) as opened:
        yield opened


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Asked:
    return Asked(monkeypatch)


@pytest.fixture
def cell(tmp_path: Path, records: CarriedRecords, world: Asked) -> Cell:
    """A bridge whose run was aborted while b, a robot of another bridge, was at a task of it and does not answer."""
    cell = adopted(tmp_path, records)
    hear_all(cell)
    begin(cell, 1)
    ((robot, key),) = world.asked
    assert robot == "b"
    accept(cell, key)
    cell.go_on(1.0)
    side = cast("Any", cell.side)
    side._do(side._holder.take_end("run", "aborted", "stop it", 0, cell.now))
    return cell


def test_a_robot_is_told_again_after_its_run_is_over(cell: Cell, world: Asked) -> None:
    assert told_at(cell, world, 100.0) == [5, 10, 20, 40, 80]


def test_a_robot_is_told_again_after_a_restart(
    cell: Cell, world: Asked, tmp_path: Path, records: CarriedRecords
) -> None:
    told_at(cell, world, 60.0)
    world.halted.clear()
    again = Cell("cell", tmp_path, records, CFG)
    again.now = cell.now
    again.go_on(0.1)
    told_at(again, world, 60.0)
    assert [robot for robot, _ in world.halted[:2]] == ["b", "b"]
