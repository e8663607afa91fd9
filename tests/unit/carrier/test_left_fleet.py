"""A skill or robot that left fleet.yaml while its task was at work: nobody knows what became of it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.unit.carrier.test_halts import CFG, Asked, accept, begin, take
from tests.unit.carrier.test_stand_ins import MODEL, Cell, hear_all, of
from ua_fleet.config.schema import FleetConfig
from ua_fleet.scenario.facts import TaskOutcome, TaskOver, Then
from ua_fleet.storage.carried_records import CarriedRecords


def no_change(_model: dict[str, Any]) -> None:
    pass


def rename_skill(model: dict[str, Any]) -> None:
    model["robots"]["a"]["skills"] = {"job": {"id": 1201, "needs": ["mobile"]}}


def take_robot_out(model: dict[str, Any]) -> None:
    del model["robots"]["a"]


@pytest.fixture
def records(tmp_path: Path) -> Iterator[CarriedRecords]:
    with CarriedRecords(tmp_path) as opened:
        yield opened


@pytest.mark.parametrize("is_asked", [True, False], ids=["at work", "never asked"])
@pytest.mark.parametrize("change", [no_change, rename_skill, take_robot_out])
def test_no_second_robot_begins_what_the_first_may_be_at(
    tmp_path: Path,
    records: CarriedRecords,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[dict[str, Any]], None],
    *,
    is_asked: bool,
) -> None:
    world = Asked(monkeypatch)
    cell = Cell("cell", tmp_path, records, CFG)
    take(cell)
    hear_all(cell)
    begin(cell, 0)
    ((robot, key),) = world.asked
    assert robot == "a"
    if is_asked:
        accept(cell, key)
    else:
        world.known.clear()
    world.asked.clear()
    model = copy.deepcopy(MODEL)
    change(model)
    again = Cell("cell", tmp_path, records, FleetConfig.model_validate(model))
    again.now = cell.now + 1
    again.go_on(0.1)
    hear_all(again)
    again.go_on(1.0)
    over = [(fact.outcome, fact.then) for fact in of(records, 0) if isinstance(fact, TaskOver)]
    robots = [robot for robot, _ in world.asked]
    if change is no_change:
        assert (over, robots) == ([], [] if is_asked else ["a"])
    elif is_asked:
        assert (over, robots) == ([(TaskOutcome.UNKNOWN, Then.ASK)], []), "a person is asked"
    else:
        assert (over, robots) == ([(TaskOutcome.REFUSED, Then.REPLACE)], ["b"])
