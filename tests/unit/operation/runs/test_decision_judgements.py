"""Judgements of one decision: kept over restarts until it is decided, and no longer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.operation.runs.test_kept_settings import CRITERIA
from tests.unit.operation.runs.world import CONFIG, World
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import JudgementsInvalid, StorageUnavailable
from ua_fleet.operation.runs.library import ScenarioUnknown
from ua_fleet.resilience import Judgements

RESILIENCE = {
    "mode": "operator",
    "criteria": CRITERIA,
    "judgements": {"battery": {"availability": 2}},
}
OTHER: Judgements = {("battery", "availability"): 5.0}


def configured() -> FleetConfig:
    return FleetConfig.model_validate(CONFIG.model_dump(exclude_unset=True) | {"resilience": RESILIENCE})


def deciding(folder: Path, config: FleetConfig | None = None) -> tuple[World, str]:
    """An open decision."""
    world = World(folder, config=config or configured())
    if not world.service.run_ids:
        world.service.fault_reports.raise_fault("left", "hot")
        run_id = world.start()
    else:
        (run_id,) = world.service.run_ids
    return world, f"{run_id}.0"


def weight(world: World, decision_id: str) -> float:
    ranking = world.service.decisions.preview(decision_id, None)
    return round(ranking.weights.of("battery"), 3)


def test_they_outlast_the_server(tmp_path: Path) -> None:
    world, decision_id = deciding(tmp_path)
    assert weight(world, decision_id) == pytest.approx(0.667)
    assert world.service.decisions.judge(decision_id, OTHER, "otto").weights.of("battery") == pytest.approx(5 / 6)
    world.journal.close()
    world, decision_id = deciding(tmp_path)
    assert weight(world, decision_id) == pytest.approx(0.833)
    assert world.service.settings.judgements == {("battery", "availability"): 2.0}, "those of all stay"
    world.service.decisions.judge(decision_id, None, "otto")
    assert world.journal.settings() == {}
    assert weight(world, decision_id) == pytest.approx(0.667)


def test_they_are_over_with_the_decision(tmp_path: Path) -> None:
    world, decision_id = deciding(tmp_path)
    world.service.decisions.judge(decision_id, OTHER, "otto")
    assert [one.by for one in world.journal.settings().values()] == ["otto"]
    world.service.decisions.confirm(decision_id, "right", "otto")
    assert world.journal.settings() == {}
    with pytest.raises(ScenarioUnknown, match="it may have been decided already"):
        world.service.decisions.judge(decision_id, OTHER, "otto")


def test_those_that_do_not_fit_the_criteria_any_more_do_not_count(tmp_path: Path) -> None:
    world, decision_id = deciding(tmp_path)
    world.service.decisions.judge(decision_id, OTHER, "otto")
    world.journal.close()
    alone = RESILIENCE | {"criteria": {"battery": CRITERIA["battery"]}, "judgements": {}}
    config = FleetConfig.model_validate(CONFIG.model_dump(exclude_unset=True) | {"resilience": alone})
    world, decision_id = deciding(tmp_path, config)
    assert world.service.decisions.preview(decision_id, None).weights.names == ("battery",)
    assert world.journal.settings() == {}


def test_those_of_a_run_that_is_over_are_forgotten_at_the_next_start(tmp_path: Path) -> None:
    """The server was killed between the end of the run and that of its decisions."""
    world, decision_id = deciding(tmp_path)
    world.service.decisions.judge(decision_id, OTHER, "otto")
    (name, kept), *_ = world.journal.settings().items()
    world.journal.keep_setting(name.replace(decision_id, "20260101-000000-abcdef.1"), kept)
    world.journal.close()
    world, _ = deciding(tmp_path)
    assert list(world.journal.settings()) == [name]


def test_what_cannot_be_weighed_or_kept_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world, decision_id = deciding(tmp_path)
    with pytest.raises(JudgementsInvalid, match="not compared"):
        world.service.decisions.judge(decision_id, {("battery", "battery"): 1.0}, "otto")

    def full(*_: object) -> None:
        raise StorageUnavailable("the disk is full")

    monkeypatch.setattr(world.journal, "keep_setting", full)
    with pytest.raises(StorageUnavailable):
        world.service.decisions.judge(decision_id, OTHER, "otto")
    assert weight(world, decision_id) == pytest.approx(0.667)
