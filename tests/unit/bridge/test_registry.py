from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import metadata
from types import ModuleType

import pytest

from tests.unit.bridge.mute import Mute
from ua_fleet.bridge import Driver, load_driver, registry
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


def install(monkeypatch: pytest.MonkeyPatch, create_driver: Callable[[FleetConfig, str], object]) -> None:
    """A package of the kind `virtual`, whose module `driver` has this function."""
    module = ModuleType("some_bridges.virtual.driver")
    module.create_driver = create_driver  # type: ignore[attr-defined]  # a module made by hand
    for name in ("some_bridges", "some_bridges.virtual"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, module.__name__, module)


def test_driver_comes_from_the_package_of_its_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[FleetConfig, str]] = []
    driver = Mute()

    def create_driver(fleet: FleetConfig, name: str) -> Driver:
        made.append((fleet, name))
        return driver

    install(monkeypatch, create_driver)
    fleet = config("virtual")
    assert load_driver(fleet, "arm") is driver
    assert made == [(fleet, "arm")]


def test_a_driver_of_another_base_class_is_refused_with_what_to_change(monkeypatch: pytest.MonkeyPatch) -> None:
    class Old:
        """It has the methods of a driver, as drivers had before there was a base class."""

    install(monkeypatch, lambda _config, _name: Old())
    with pytest.raises(BridgeUnavailable, match=r"Old is no Driver; derive it from ua_fleet\.bridge\.Driver"):
        load_driver(config("virtual"), "arm")


def test_unknown_kind_names_those_that_there_are() -> None:
    with pytest.raises(
        BridgeUnavailable, match="bridge arm: no bridge of kind 'tcp' is installed; there are: ur, virt"
    ):
        load_driver(config("tcp"), "arm")


def test_missing_library_names_the_extra_to_install() -> None:
    with pytest.raises(BridgeUnavailable, match="No module named 'some_bridges'; install ua-fleet with its extra ur "):
        load_driver(config("ur"), "arm")
