# pyright: basic, reportMissingImports=false
"""Ridgeback, a mobile base, with the arm Sawyer on top: a ROS 1 robot.

`fetch` is a skill of this program (`ua_bridges.robot`). `go` is the action server `move_base` that such robots have,
and `load` a service of the arm; both are mapped in `fleet.yaml`, and know nothing of a fleet.

On the way to UR3 the drive fails, each time: the robot says that it is not mobile any more, and stands still; its arm
works on. Some time after the arm has loaded the box the drive turns again, so that the nine tasks can be run once more.
"""

from __future__ import annotations

import argparse
import threading
from typing import Any

from ua_demo.report import report
from ua_demo.ros_node import RosNode, connect
from ua_demo.talkrobots.robots.mobile import MobileBase

FETCH_ID, GO_ID, FAULT_ID = 1010, 1011, 1001
GRASP_S, PLACE_S, LOAD_S = 5.0, 3.0, 10.0
GIVE_UP_S = 600.0
"""So long move_base tries to drive on before it gives up by itself."""
RESET_S = 60.0
"""After loading, until the drive turns again."""


class Ridgeback:
    """The robot's program."""

    def __init__(self, node: RosNode, speed: float, space: int) -> None:
        self._node, self._speed = node, speed
        self._base = MobileBase(node, x_m=0.0, y_m=3.0, battery=90.0, speed=speed)
        self._robot = node.robot(space, fault_id=FAULT_ID)
        self._robot.skill(FETCH_ID)(self.fetch)
        node.serve("/sawyer/load", self._load)

    def fetch(self, execution: Any, table: str, to: str) -> dict[str, float]:
        """Drive to a table, take the box, and bring it somewhere."""
        report("ridgeback", "begins fetch", execution=execution.id)
        way_m = self._base.drive(table, execution.canceled)
        execution.canceled.wait(GRASP_S / self._speed)
        execution.progress(0.5, f"brings the box to {to}")
        way_m += self._base.drive(to, execution.canceled)
        execution.canceled.wait(PLACE_S / self._speed)
        execution.check()
        return {"way": way_m}

    def go(self, to: str, canceled: threading.Event) -> bool:
        """Drive somewhere; whether it has arrived."""
        if to != "ur3":
            self._base.drive(to, canceled)
            return not canceled.is_set()
        self._base.drive(to, canceled, share=0.5)
        if not canceled.is_set():
            report("ridgeback", "stands still: its drive does not turn")
            self._robot.fault("mobile: the drive does not turn")
        canceled.wait(GIVE_UP_S)
        return False

    def _load(self) -> str:
        report("ridgeback", "begins load")
        self._node.wait(LOAD_S / self._speed)
        reset = threading.Timer(RESET_S / self._speed, self._robot.repaired)
        reset.daemon = True
        reset.start()
        return "the box is on the platform"

    def offer_move_base(self) -> None:
        """Offer `go` as the action server of ROS 1."""
        import actionlib
        from move_base_msgs.msg import MoveBaseAction, MoveBaseResult

        under_way: dict[str, threading.Event] = {}

        def drive(handle: Any, canceled: threading.Event) -> None:
            arrived = self.go(handle.get_goal().target_pose.header.frame_id, canceled)
            if arrived:
                handle.set_succeeded(MoveBaseResult(), "arrived")
            elif canceled.is_set():
                handle.set_canceled(MoveBaseResult(), "stopped")
            else:
                handle.set_aborted(MoveBaseResult(), "the drive does not turn")

        def on_goal(handle: Any) -> None:
            goal_id = handle.get_goal_id().id
            canceled = under_way[goal_id] = threading.Event()
            report("ridgeback", "begins go", execution=goal_id)
            handle.set_accepted()
            threading.Thread(target=drive, args=(handle, canceled), daemon=True).start()

        def on_cancel(handle: Any) -> None:
            under_way[handle.get_goal_id().id].set()

        actionlib.ActionServer("/move_base", MoveBaseAction, on_goal, on_cancel, auto_start=False).start()

    def offer_own_go(self) -> None:
        """Offer `go` by this program, where there is no ROS 1."""

        def go(execution: Any, to: str) -> None:
            report("ridgeback", "begins go", execution=execution.id)
            if not self.go(to, execution.canceled):
                execution.check()
                raise RuntimeError("the drive does not turn")

        self._robot.skill(GO_ID)(go)


def main() -> None:
    """Run the robot until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--space", type=int, default=1, help="1: ROS 1; else a ROS 2 domain")
    options = parser.parse_args()
    ros = 1 if options.space == 1 else 2
    node = connect(ros, "ridgeback")
    robot = Ridgeback(node, options.speed, options.space)
    robot.offer_move_base() if ros == 1 else robot.offer_own_go()
    report("ridgeback", "is ready")
    node.stopped.wait()
    node.close()


if __name__ == "__main__":
    main()
