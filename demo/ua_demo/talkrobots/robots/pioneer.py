"""A Pioneer, a small mobile robot in ROS 2, whose program offers one skill by itself."""

from __future__ import annotations

import argparse
from typing import Any

from ua_demo.report import report
from ua_demo.ros_node import connect
from ua_demo.talkrobots.robots.mobile import PLACES, MobileBase


def main() -> None:
    """Run the robot until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--name", required=True)
    parser.add_argument("--space", type=int, required=True)
    parser.add_argument("--go-id", type=int, required=True, help="id of the skill in fleet.yaml")
    parser.add_argument("--at", type=float, nargs=2, default=(0.0, 0.0), help="where it stands, in metres")
    parser.add_argument("--battery", type=float, default=100.0, help="in percent")
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(2, options.name)
    x_m, y_m = options.at
    base = MobileBase(node, x_m, y_m, battery=options.battery, speed=options.speed)

    # The package is on this robot: a function is a skill.
    from ua_bridges.robot import Refused

    def go(execution: Any, to: str) -> None:
        if to not in PLACES:
            raise Refused(f"{options.name} knows no place {to!r}")
        report(options.name, "begins go", execution=execution.id, to=to)
        base.drive(to, execution.canceled)
        execution.check()

    node.robot(options.space).skill(options.go_id)(go)
    base.obey(options.space)
    report(options.name, "is ready")
    node.stopped.wait()
    node.close()


if __name__ == "__main__":
    main()
