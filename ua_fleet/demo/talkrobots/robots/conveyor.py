"""The conveyor between two tables: a service in ROS 2 moves a box from one end to the other."""

from __future__ import annotations

import argparse

from ua_fleet.demo.ros_node import connect, report

TRANSPORT_S = 15.0


def main() -> None:
    """Run the conveyor until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(2, "conveyor")
    tell_running = node.publisher("/conveyor/running", "std_msgs/Bool")

    def transport() -> str:
        report("conveyor", "runs")
        tell_running(True)
        node.wait(TRANSPORT_S / options.speed)
        tell_running(False)
        return "the box is at the end"

    node.serve("/conveyor/transport", transport)
    tell_running(False)
    report("conveyor", "is ready")
    node.stopped.wait()
    node.close()


if __name__ == "__main__":
    main()
