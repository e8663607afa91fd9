"""The benchmark `skill_start`: its fleet is a legal one, and has each way that is measured."""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks import skill_start
from ua_fleet.config.load import load
from ua_fleet.config.security import all_groups


def test_the_fleet_is_legal_and_provided_for(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    raw = skill_start.fleet_of("http://127.0.0.1:11311", 42)
    fleet.write_text(json.dumps(raw))
    config = load(fleet)
    skills = {f"{robot}.{skill}" for robot, one in config.robots.items() for skill in one.skills}
    assert {way.skill for way in skill_start.WAYS} == skills
    skill_start.provide(tmp_path, raw)
    assert {path.name.partition(".")[0] for path in (tmp_path / "keys").iterdir()} >= set(all_groups(config))
