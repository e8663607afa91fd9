"""Making the Modbus driver."""

from __future__ import annotations

from ua_bridges.modbus.session import ModbusDriver
from ua_fleet.config.schema import FleetConfig

__all__ = ["create_driver"]


def create_driver(config: FleetConfig, bridge_name: str) -> ModbusDriver:
    """The driver of a Modbus bridge, not started."""
    return ModbusDriver(config, bridge_name)
