"""Fleets whose bridges are of a kind that is not installed: what a file says, as a configuration."""

from __future__ import annotations

from typing import Any, cast

from ua_fleet.config.connections import FleetOfConnections
from ua_fleet.config.schema import FleetConfig

__all__ = ["fleet_of"]


def fleet_of(raw: dict[str, Any]) -> FleetConfig:
    """A fleet over one connection, or over a list of them."""
    if not isinstance(raw["pubsub"], list):
        return FleetConfig.model_validate(raw)
    first, *further = cast("list[dict[str, Any]]", raw["pubsub"])
    return FleetOfConnections.model_validate({**raw, "pubsub": first, "further": further})
