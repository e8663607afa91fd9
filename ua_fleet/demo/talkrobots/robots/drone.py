"""A Parrot drone in ROS 2: it is told by empty messages, and tells in which state of flight it is."""

from __future__ import annotations

import argparse
import threading
from typing import Any

from ua_fleet.demo.ros_node import connect, report

TAKE_OFF_S, LAND_S = 6.0, 6.0


def main() -> None:
    """Run the drone until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(2, "drone")
    tell_state = node.publisher("/bebop/flying_state", "std_msgs/String")

    def fly(through: str, to: str, seconds: float) -> None:
        tell_state(through)
        report("drone", f"is {through}")
        node.stopped.wait(seconds / options.speed)
        tell_state(to)

    def take_off(_message: Any) -> None:
        threading.Thread(target=fly, args=("taking off", "hovering", TAKE_OFF_S), daemon=True).start()

    def land(_message: Any) -> None:
        threading.Thread(target=fly, args=("landing", "landed", LAND_S), daemon=True).start()

    node.subscribe("/bebop/takeoff", "std_msgs/Empty", take_off, latched=False)
    node.subscribe("/bebop/land", "std_msgs/Empty", land, latched=False)
    tell_state("landed")
    report("drone", "is ready")
    node.stopped.wait()
    node.close()


if __name__ == "__main__":
    main()
