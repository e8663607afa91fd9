"""A robot that people drive by hand, as lists of robots see it."""

from __future__ import annotations

from ua_fleet.config.load import load_content
from ua_fleet.config.nodes import fleet_model
from ua_fleet.counters import Counters
from ua_fleet.fleet import RobotState
from ua_fleet.fleet.state import FleetState
from ua_fleet.topics import Topic

FILE = b"""\
version: 1
pubsub: {security: none}
bridges: {floor: {kind: ros2, space: 2, status_id: 1001}}
robots:
  carrier:
    bridge: floor
    data:
      cmd_vel:
        id: 1002
        origin: server
        type: Double
        sink: {topic: /speed, type: std_msgs/Float64}
    teleoperation:
      id: 1003
      acquire_id: 1004
      renew_id: 1005
      release_id: 1006
      data: cmd_vel
      axes: {value: {speed: 0.5, acceleration: 0.5, jerk: 4.0}}
      robot_timeout_ms: 500
"""


def state() -> FleetState:
    made = FleetState(fleet_model(load_content(FILE, "f.yaml", {})), Counters())
    made.tick(1)
    return made


def test_its_setpoints_are_no_source_that_it_is_reached_by() -> None:
    """It was offline for ever, since nobody publishes them to the server."""
    fleet = state()
    robot = fleet.robot_status("carrier")
    assert robot is not None
    assert robot.sources == ()
    assert robot.bridge is not None
    robot.bridge.set_online(True, 2)
    fleet.tick(3)
    assert fleet.robot_states == {"carrier": RobotState.IDLE}


def test_it_is_busy_while_it_is_driven() -> None:
    fleet = state()
    robot = fleet.robot_status("carrier")
    assert robot is not None
    assert robot.bridge is not None
    robot.bridge.set_online(True, 2)
    fleet.tick(3)
    assert [change.value for change in fleet.set_driven("carrier", "driven by hand by anna", 4)] == [RobotState.BUSY]  # type: ignore[union-attr]  # it is the value of State
    assert fleet.set_driven("carrier", "driven by hand by anna", 5) == []
    assert robot.driven_by == "driven by hand by anna"
    fleet.set_driven("carrier", "", 6)
    assert fleet.robot_states == {"carrier": RobotState.IDLE}


def test_its_ids_are_its_own() -> None:
    fleet = state()
    assert all(fleet.knows(Topic(2, 2, number)) for number in range(1003, 1007))
    assert fleet.owner(2, 1004) == Topic(2, 2, 1004)
