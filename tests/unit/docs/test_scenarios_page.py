"""The scenarios on their page fit the fleet on it, and would be done."""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path

from tests.unit.docs.pages import ROOT, blocks
from ua_fleet.config import load
from ua_fleet.config.nodes import fleet_model
from ua_fleet.operation.runs.values import FleetValues, fleet_view
from ua_fleet.orchestrator.dry_run import dry_run
from ua_fleet.scenario import read_scenario, validate
from ua_fleet.scenario.facts import RunOutcome
from ua_fleet.scenario.read import STEP_KEYS


def test_scenarios_fit_their_fleet_and_would_be_done(tmp_path: Path) -> None:
    (fleet,) = [block for block in blocks("yaml") if block.page.name == "scenarios.md"]
    (tmp_path / "fleet.yaml").write_text(fleet.text, encoding="utf-8")
    config = load(tmp_path / "fleet.yaml", {})
    model = fleet_model(config)
    view = fleet_view(model.robots, FleetValues(model).meanings)
    scenarios = [block for block in blocks("yml") if block.page.name == "scenarios.md"]
    assert scenarios
    for block in scenarios:
        reading = read_scenario(block.text.encode(), block.place)
        checked = validate(reading.scenario, view, block.place)
        assert [*reading.problems, *checked.problems] == []
        run = dry_run(checked.scenario, view, config.resilience.settings(), {}, {"temperature": 20.0})
        assert run.outcome is RunOutcome.DONE, run


def test_all_keys_of_steps_are_told_and_no_others() -> None:
    page = (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
    told = re.findall(
        r"^\| `(\w+)`(?:: `(\w+)`)? \|", page.partition("### All keys")[2].partition("\n## ")[0], re.MULTILINE
    )
    known = chain.from_iterable(
        [(kind, "" if key == kind else key) for key in keys] for kind, keys in STEP_KEYS.items()
    )
    assert sorted(told) == sorted(known)
