"""Teleoperation in `fleet.yaml`: a robot that people drive by hand, and within which limits."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from ua_fleet.config.base import DataSetId, Model, Name
from ua_fleet.teleoperation.model import AxisLimits

__all__ = ["TELEOPERATION_IDS", "AxisConfig", "TeleoperationConfig"]

TELEOPERATION_IDS: Final = ("id", "acquire_id", "renew_id", "release_id")
"""Keys of its numeric ids."""

Limit = Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]


class AxisConfig(Model, frozen=True):
    """What one axis does at most, in both directions, in the unit of its field and seconds."""

    speed: Limit
    """Greatest setpoint; what is wished beyond is held to it."""
    acceleration: Limit
    """Greatest change of the setpoint in a second, while it follows the operator."""
    deceleration: Limit | None = None
    """The same while it is stopped, since no fresh setpoint comes; `acceleration` if left out."""
    jerk: Limit
    """Greatest change of the acceleration in a second."""

    def model(self) -> AxisLimits:
        """The limits as the bridge knows them."""
        return AxisLimits(self.speed, self.acceleration, self.deceleration or self.acceleration, self.jerk)


class TeleoperationConfig(Model, frozen=True):
    """How a robot is driven by hand; see docs/teleoperation.md. It is no safety function."""

    id: DataSetId | None = None
    """Needed in the end: numeric id of its Object and of what the bridge publishes of it. `ua-fleet config assign-ids`
    fills it in, as the next three."""
    acquire_id: DataSetId | None = None
    """Needed in the end: numeric id of the Action Acquire."""
    renew_id: DataSetId | None = None
    """Needed in the end: numeric id of the Action Renew."""
    release_id: DataSetId | None = None
    """Needed in the end: numeric id of the Action Release."""
    data: Name
    """Which of the robot's data takes the setpoints: of origin server, with a `sink`; clients do not write it then."""
    axes: dict[str, AxisConfig] = Field(min_length=1)
    """Limits of each field of that data, by its name; a single field is `value`."""
    deadman_ms: int = Field(default=300, ge=100, le=5000)
    """The robot is stopped when its newest setpoint echoes a counter that the bridge published longer ago."""
    robot_timeout_ms: int = Field(ge=20, le=10_000, examples=[500])
    """So soon the robot stops by itself when nothing comes from the bridge: by its own watch, which `ua_bridges.robot`
    has for ROS programs. Nothing else stops a robot whose bridge is dead."""
    period_ms: int = Field(default=20, ge=5, le=200)
    """How often the bridge writes to the robot while it is driven."""

    @property
    def ids(self) -> tuple[int | None, int | None, int | None, int | None]:
        """All four."""
        return self.id, self.acquire_id, self.renew_id, self.release_id
