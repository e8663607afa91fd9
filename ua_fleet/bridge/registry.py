"""Bridge packages by kind. They are found through entry points, so that a new kind changes nothing here."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib import metadata
from typing import Any, Final

from ua_fleet.bridge.driver import Driver
from ua_fleet.config.schema import BridgeConfig, FleetConfig
from ua_fleet.config.topics_seen import TopicSeen
from ua_fleet.errors import BridgeUnavailable

__all__ = ["ENTRY_POINT_GROUP", "load_driver", "topics_of"]

ENTRY_POINT_GROUP: Final = "ua_fleet.bridges"
"""Entry points of a bridge package: its kind, and the configuration model in its `config.py`."""


def load_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """Make the driver of a configured bridge; only here is the package with its libraries imported.

    Raises:
        BridgeUnavailable: no such kind of bridge, a library that it needs is missing, or what it makes is no Driver.
    """
    create: Callable[[FleetConfig, str], object] = _part(config, bridge_name, "driver").create_driver
    driver = create(config, bridge_name)
    if not isinstance(driver, Driver):
        made = f"{type(driver).__module__}.{type(driver).__qualname__}"
        raise BridgeUnavailable(f"bridge {bridge_name}: {made} is no Driver; derive it from ua_fleet.bridge.Driver")
    return driver


def topics_of(config: FleetConfig, bridge_name: str, within_s: float) -> list[TopicSeen]:
    """The topics that are in the space of a configured bridge now, by the module `topics` of its package.

    Raises:
        BridgeUnavailable: bridges of its kind have no topics, or a library that it needs is missing.
        NotConnected: the space cannot be reached.
    """
    seen: Callable[[BridgeConfig, float], list[TopicSeen]] = _part(config, bridge_name, "topics").topics_seen
    return seen(config.bridges[bridge_name], within_s)


def _part(config: FleetConfig, bridge_name: str, name: str) -> Any:
    """A module of the package of a bridge's kind."""
    kind = config.bridges[bridge_name].kind
    entry = next(iter(metadata.entry_points(group=ENTRY_POINT_GROUP, name=kind)), None)
    if entry is None:
        known = ", ".join(sorted(metadata.entry_points(group=ENTRY_POINT_GROUP).names))
        raise BridgeUnavailable(f"bridge {bridge_name}: no bridge of kind {kind!r} is installed; there are: {known}")
    module = f"{entry.module.rpartition('.')[0]}.{name}"
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if error.name == module:
            raise BridgeUnavailable(f"bridge {bridge_name}: bridges of kind {kind} have no {name}") from error
        extras = metadata.metadata("ua-fleet").get_all("Provides-Extra") or []
        raise BridgeUnavailable(f"bridge {bridge_name}: {error}", extra=kind if kind in extras else "") from error
