"""UR3, an arm. Its skills are a service and a topic of its ROS 2 driver, mapped in `fleet.yaml`."""

from __future__ import annotations

import argparse
import threading
from typing import Any

from ua_fleet.demo.ros_node import connect, report

GRASP_S, PICK_S = 12.0, 15.0


def main() -> None:
    """Run the robot until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(2, "ur3")
    tell_angle = node.publisher("/ur3/base_angle", "std_msgs/Float64")
    tell_state = node.publisher("/ur3/state", "std_msgs/String")

    def grasp() -> str:
        report("ur3", "takes the box from the conveyor, and puts it on the ground")
        node.wait(GRASP_S / options.speed)
        return "the box is on the ground"

    def pick(angle: float) -> None:
        tell_state("turning")
        report("ur3", f"turns {abs(angle):g} degrees to the {'left' if angle > 0 else 'right'}, and picks a box")
        node.stopped.wait(PICK_S / options.speed)
        tell_angle(angle)
        tell_state("holding")

    def asked(message: Any) -> None:
        threading.Thread(target=pick, args=(float(message.data),), daemon=True).start()

    node.serve("/ur3/grasp", grasp)
    node.subscribe("/ur3/pick", "std_msgs/Float64", asked, latched=False)
    tell_angle(0.0)
    tell_state("free")
    report("ur3", "is ready")
    node.stopped.wait()
    node.close()


if __name__ == "__main__":
    main()
