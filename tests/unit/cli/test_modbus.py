"""`ua-fleet modbus map`, and what is said where there is nothing to serve."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.unit.cli.conftest import Invoke

FLEET = """\
version: 1
pubsub: {security: none}
bridges: {cell: {kind: ros1, status_id: 1}}
robots: {arm: {bridge: cell, data: {angle: {id: 3, type: Double, unit: deg}}}}
"""
MODBUS = (
    "modbus: {values: {arm.angle: {table: input, address: 60, type: int16, scale: 0.1, offset: -5, order: DCBA}}}\n"
)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_map_is_a_table(invoke: Invoke, folder: Path) -> None:
    (folder / "fleet.yaml").write_text(FLEET + MODBUS)
    ended = invoke("modbus", "map")
    assert ended.code == 0
    assert "| input | 60 | int16 x 0.1 -5 | reads | arm.angle | deg |  |" in ended.stdout.splitlines()


def test_map_as_json_has_all_that_a_generator_needs(invoke: Invoke, folder: Path) -> None:
    (folder / "fleet.yaml").write_text(FLEET + MODBUS)
    rows = [json.loads(line) for line in invoke("modbus", "map", "--json").stdout.splitlines()]
    (angle,) = [row for row in rows if row["name"] == "arm.angle"]
    assert angle == {
        "table": "input",
        "address": 60,
        "count": 1,
        "type": "int16",
        "bit": None,
        "scale": 0.1,
        "offset": -5.0,
        "order": "DCBA",
        "name": "arm.angle",
        "unit": "deg",
        "plc_writes": False,
        "meaning": "",
    }


@pytest.mark.parametrize("command", ["map", "serve"])
def test_fleet_that_is_no_modbus_device(invoke: Invoke, folder: Path, command: str) -> None:
    (folder / "fleet.yaml").write_text(FLEET)
    ended = invoke("modbus", command)
    assert ended.code == 3
    assert "fleet.yaml has no section `modbus`; docs/plc.md tells what stands in it" in ended.stderr
