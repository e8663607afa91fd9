"""Skills of a robot's own program, for its programmer. Needs Python and rclpy or rospy, nothing of ua_fleet.

    from ua_bridges.robot.ros2 import Robot          # rospy: from ua_bridges.robot.ros1 import Robot

    robot = Robot(node, space=2)                     # rospy: Robot()

    @robot.skill(1010)                               # its id in fleet.yaml
    def drive(execution, to, speed=0.2):
        execution.progress(0.5, "half way")
        return {"distance": 3.2}

    robot.fault("motor overheated")                  # with Robot(..., fault_id=1013); robot.repaired() when it is

    @robot.driven("/cmd_vel", Twist, timeout_s=0.5)  # robot_timeout_ms in fleet.yaml
    def move(twist):                                 # a zero comes when nobody drives any more, whatever has failed
        ...

The function of a skill runs in a thread of its own, once for each execution, whatever is repeated on the network. It
returns the results by their names; an exception means that it failed, `Refused` that nothing was begun.
`docs/skills-json.md` has the messages, `docs/teleoperation.md` what a robot does that is driven by hand.
"""

from ua_bridges.robot.driven import Driven
from ua_bridges.robot.program import Announcer, Busy, Canceled, Execution, Program, Refused

__all__ = [
    "Announcer",
    "Busy",
    "Canceled",
    "Driven",
    "Execution",
    "Program",
    "Refused",
]
