"""A fleet with three bridges; the arm commands the rover, and nobody but itself commands the PLC."""

from __future__ import annotations

from typing import Any

from ua_fleet.config.schema import FleetConfig


def fleet(**pubsub: Any) -> FleetConfig:
    return FleetConfig.model_validate(
        {
            "version": 1,
            "pubsub": {"security": "sign_and_encrypt", **pubsub},
            "bridges": {
                "arm": {"kind": "ros1", "space": 1},
                "rover": {"kind": "ros2", "space": 2, "requestors": [0, 1]},
                "plc": {"kind": "modbus", "space": 300, "requestors": []},
            },
        }
    )
