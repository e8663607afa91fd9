"""The kinds of bridges that are installed. Each is an entry point that names the kind's configuration model."""

from __future__ import annotations

from functools import cache
from importlib import metadata
from typing import Final

from ua_fleet.config.schema import BridgeConfig
from ua_fleet.errors import ConfigError

__all__ = ["ENTRY_POINT_GROUP", "known_kinds", "model_of_kind"]

ENTRY_POINT_GROUP: Final = "ua_fleet.bridges"


@cache
def _installed() -> metadata.EntryPoints:
    """Looked up once: it reads a file of every package that is installed."""
    return metadata.entry_points(group=ENTRY_POINT_GROUP)


def known_kinds() -> tuple[str, ...]:
    """The installed kinds, sorted."""
    return tuple(sorted(_installed().names))


def model_of_kind(kind: str) -> type[BridgeConfig]:
    """The configuration model of an installed kind; raises ConfigError when its package is broken."""
    entry = next(iter(_installed().select(name=kind)))
    try:
        model = entry.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"bridges of kind {kind} cannot be configured: {error}") from error
    if not (isinstance(model, type) and issubclass(model, BridgeConfig)):
        raise ConfigError(f"bridges of kind {kind} cannot be configured: {entry.value} is no BridgeConfig")
    return model
