"""Robots that are driven by hand: leases, the watch over setpoints, and the ramp that stops the robot.

Pure: no I/O, no event loop; time is an argument. `Control` is one robot, `messages` says what travels. The bridge hosts
it (`ua_fleet.bridge.teleoperation`), so the stop is made on the robot's side of every network, and what is beyond that
is the robot's own watch. It is no safety function: see docs/teleoperation.md.
"""

from ua_fleet.teleoperation.control import Control
from ua_fleet.teleoperation.leases import Lease
from ua_fleet.teleoperation.messages import Granted, Setpoint, State, Status
from ua_fleet.teleoperation.model import AxisLimits, SetpointAddress, TeleoperationModel

__all__ = [
    "AxisLimits",
    "Control",
    "Granted",
    "Lease",
    "Setpoint",
    "SetpointAddress",
    "State",
    "Status",
    "TeleoperationModel",
]
