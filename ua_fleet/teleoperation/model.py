"""What `fleet.yaml` says of the teleoperation of one robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

from ua_fleet.topics import SERVER_SPACE, Topic

__all__ = ["COUNTER_PERIOD_S", "LEASE_S", "AxisLimits", "SetpointAddress", "TeleoperationModel"]

COUNTER_PERIOD_S: Final = 0.05
"""How often the bridge publishes its counter while a lease is held."""
LEASE_S: Final = 5.0
"""A lease of which nothing is heard for so long is over: neither Renew nor a setpoint that was taken."""


class AxisLimits(NamedTuple):
    """What an axis does at most, in its unit and seconds, in both directions."""

    speed: float
    """Greatest setpoint, e.g. m/s."""
    acceleration: float
    """Greatest change of the setpoint in a second, while it follows the operator."""
    deceleration: float
    """The same while it is stopped because nobody drives any more."""
    jerk: float
    """Greatest change of the acceleration in a second."""

    @property
    def stop_s(self) -> float:
        """How long a stop takes at most, from any state that these limits allow.

        The slope that it has is taken away, the greatest setpoint is braked, and the brake is let go.
        """
        return self.acceleration / self.jerk + self.speed / self.deceleration + self.deceleration / self.jerk


class SetpointAddress(NamedTuple):
    """Where the setpoints of one robot travel: the server's WriterGroup for its bridge, and their DataSetWriter."""

    writer_group_id: int
    """The `status_id` of the robot's bridge."""
    data_set_writer_id: int
    """The `id` of the robot's teleoperation."""

    @property
    def publisher_id(self) -> int:
        """The server's."""
        return SERVER_SPACE


@dataclass(frozen=True, slots=True)
class TeleoperationModel:
    """One robot that can be driven by hand."""

    robot: str
    data: Topic
    """The data that takes the setpoints; nothing else is written to it."""
    axes: tuple[tuple[str, AxisLimits], ...]
    """Fields of that data in its order, with their limits."""
    status: Topic
    """What the bridge publishes of the lease; its id is the Object's too."""
    setpoints: SetpointAddress
    acquire: Topic
    """The Actions, each with one target, which has the robot's name."""
    renew: Topic
    release: Topic
    deadman_s: float
    """The robot is stopped when the newest setpoint echoes a counter that was published longer ago."""
    robot_timeout_s: float
    """So soon the robot stops by itself when its bridge says nothing."""
    period_s: float
    """How often the bridge writes to the robot."""
    units: tuple[str | None, ...] = ()
    """Of the axes, as shown to users."""

    @property
    def stop_s(self) -> float:
        """How long a stop takes at most once it has begun: that of the slowest axis."""
        return max(limits.stop_s for _, limits in self.axes)

    @property
    def actions(self) -> tuple[Topic, Topic, Topic]:
        """All three."""
        return self.acquire, self.renew, self.release
