"""Bridge packages by kind. They are found through entry points, so that a new kind changes nothing here."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib import metadata
from typing import Final

from ua_fleet.bridge.driver import Driver
from ua_fleet.config.schema import FleetConfig
from ua_fleet.errors import BridgeUnavailable

__all__ = ["ENTRY_POINT_GROUP", "load_driver"]

ENTRY_POINT_GROUP: Final = "ua_fleet.bridges"
"""Entry points of a bridge package: its kind, and the configuration model in its `config.py`."""


def load_driver(config: FleetConfig, bridge_name: str) -> Driver:
    """Make the driver of a configured bridge; only here is the package with its libraries imported.

    Raises:
        BridgeUnavailable: no such kind of bridge, or a library that it needs is missing.
    """
    kind = config.bridges[bridge_name].kind
    entry = next(iter(metadata.entry_points(group=ENTRY_POINT_GROUP, name=kind)), None)
    if entry is None:
        known = ", ".join(sorted(metadata.entry_points(group=ENTRY_POINT_GROUP).names))
        raise BridgeUnavailable(f"bridge {bridge_name}: no bridge of kind {kind!r} is installed; there are: {known}")
    package = entry.module.rpartition(".")[0]
    try:
        module = importlib.import_module(f"{package}.driver")
    except ImportError as error:
        extras = metadata.metadata("ua-fleet").get_all("Provides-Extra") or []
        raise BridgeUnavailable(f"bridge {bridge_name}: {error}", extra=kind if kind in extras else "") from error
    create: Callable[[FleetConfig, str], Driver] = module.create_driver
    return create(config, bridge_name)
