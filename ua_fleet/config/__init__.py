"""`fleet.yaml`: its schema, and loading it with the line of every problem."""

from ua_fleet.config.load import load
from ua_fleet.config.schema import FleetConfig

__all__ = ["FleetConfig", "load"]
