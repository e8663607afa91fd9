from __future__ import annotations

import subprocess
import sys
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from tests.system import clean_environment
from ua_fleet.config import kinds
from ua_fleet.config.load import load_content
from ua_fleet.errors import ConfigInvalid

FLEET = b"version: 1\npubsub: {security: none}\nbridges:\n  a: {kind: plc, space: 300, status_id: 1, rack: 2}\n"


def install(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    entry = EntryPoint("plc", value, kinds.ENTRY_POINT_GROUP)

    monkeypatch.setattr(kinds, "_installed", lambda: EntryPoints([entry]))


def test_a_new_kind_brings_its_own_keys(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "plc_config.py").write_text(
        "from ua_fleet.config.schema import BridgeConfig\nclass PlcConfig(BridgeConfig, frozen=True):\n    rack: int\n"
    )
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    install(monkeypatch, "plc_config:PlcConfig")
    config = load_content(FLEET, "f.yaml", {"UA_FLEET__BRIDGES__A__RACK": "5"})
    assert config.bridges["a"].model_dump()["rack"] == 5
    assert kinds.known_kinds() == ("plc",)


PLC = """
from collections.abc import Iterable
from typing import ClassVar
from ua_fleet.config.schema import BridgeConfig, DataMapping

class Register(DataMapping, frozen=True):
    address: int

class PlcConfig(BridgeConfig, frozen=True):
    source_mapping: ClassVar[type[DataMapping] | None] = Register

    def problems(self, name, robots):
        for robot, config in robots.items():
            for data, data_set in config.data.items():
                path = ("robots", robot, "data", data, "source", "address")
                if data_set.source is not None and data_set.source.address > 9:
                    yield path, f"{name} has 10 registers", "use another"
"""
ROBOT = b"""version: 1
pubsub: {security: none}
bridges: {a: {kind: plc, space: 300, status_id: 1}}
robots:
  press:
    bridge: a
    data:
"""


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        ("x: {id: 2, type: Double, source: {address: 3}}", ""),
        (
            "x: {id: 2, type: Double, source: {address: 30}}",
            "f.yaml:8:robots.press.data.x.source.address: a has 10 registers; use another",
        ),
        (
            "x: {id: 2, type: Double, source: {addres: 3}}",
            "f.yaml:8:robots.press.data.x.source.addres: unknown key `addres`; did you mean `address`?",
        ),
        (
            "x: {id: 2, type: Double, origin: server, sink: {address: 3}}",
            "f.yaml:8:robots.press.data.x.sink: bridges of kind plc have no `sink`; remove `sink`",
        ),
    ],
)
def test_a_kind_says_what_data_is_read_from(
    data: str, problem: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "plc_sources.py").write_text(PLC)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    install(monkeypatch, "plc_sources:PlcConfig")
    content = ROBOT + f"      {data}\n".encode()
    if not problem:
        source = load_content(content, "f.yaml", {}).robots["press"].data["x"].source
        assert source is not None
        assert source.model_dump() == {"address": 3}
        return
    with pytest.raises(ConfigInvalid) as caught:
        load_content(content, "f.yaml", {})
    assert problem in [str(each) for each in caught.value.problems]


@pytest.mark.parametrize(
    "value", ["no_such_package.config:Config", "ua_fleet.config.schema:NoSuch", "ua_fleet.errors:ConfigError"]
)
def test_a_broken_package_is_a_problem_of_the_bridge(value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, value)
    with pytest.raises(ConfigInvalid, match=r"f\.yaml:4:bridges\.a\.kind: bridges of kind plc cannot be configured: "):
        load_content(FLEET, "f.yaml", {})


def test_loading_a_file_imports_no_robot_library_and_no_server(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(
        "version: 1\npubsub: {security: none}\nbridges:\n"
        "  a: {kind: ros1, status_id: 1}\n  b: {kind: ros2, space: 2, status_id: 2}\n"
    )
    code = (
        "import sys; from ua_fleet.config import load; load(sys.argv[1]);"
        "print([name for name in ('rospy', 'rclpy', 'asyncua') if name in sys.modules])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, path], capture_output=True, text=True, check=True, env=clean_environment()
    )
    assert run.stdout.strip() == "[]"
