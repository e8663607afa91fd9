from __future__ import annotations

import sys
from importlib import metadata
from types import ModuleType

import pytest

from ua_fleet.bridge import load_driver, registry
from ua_fleet.config.schema import BridgeConfig, FleetConfig, PubSubConfig, PubSubSecurity
from ua_fleet.errors import BridgeUnavailable


def config(kind: str) -> FleetConfig:
    pubsub = PubSubConfig(security=PubSubSecurity.NONE)
    return FleetConfig(version=1, pubsub=pubsub, bridges={"arm": BridgeConfig(kind=kind, space=300)})


@pytest.fixture(autouse=True)
def entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    points = metadata.EntryPoints(
        metadata.EntryPoint(kind, f"some_bridges.{kind}.config:Config", registry.ENTRY_POINT_GROUP)
        for kind in ("virtual", "ur")
    )
    monkeypatch.setattr(metadata, "entry_points", points.select)


def test_driver_comes_from_the_package_of_its_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("some_bridges.virtual.driver")
    made: list[tuple[FleetConfig, str]] = []

    def create_driver(fleet: FleetConfig, name: str) -> str:
        made.append((fleet, name))
        return "driver"

    module.create_driver = create_driver  # type: ignore[attr-defined]  # a module made by hand
    for name in ("some_bridges", "some_bridges.virtual"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    fleet = config("virtual")
    driver: object = load_driver(fleet, "arm")
    assert driver == "driver"
    assert made == [(fleet, "arm")]


def test_unknown_kind_names_those_that_there_are() -> None:
    with pytest.raises(
        BridgeUnavailable, match="bridge arm: no bridge of kind 'tcp' is installed; there are: ur, virt"
    ):
        load_driver(config("tcp"), "arm")


def test_missing_library_names_the_extra_to_install() -> None:
    with pytest.raises(BridgeUnavailable, match="No module named 'some_bridges'; install ua-fleet with its extra ur "):
        load_driver(config("ur"), "arm")
