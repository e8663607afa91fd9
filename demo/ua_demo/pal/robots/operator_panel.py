"""A second computer in the arm's graph that turns the conveyor belt off some time after the arm has started."""

from __future__ import annotations

import argparse
import threading
import time
from typing import Any

from ua_demo.report import report
from ua_demo.ros_node import RosNode, connect

OFF_S = 25.0
"""The line's seconds from the arm's start until the belt is turned off."""


class OperatorPanel:
    """The panel. The belt runs from each start of the arm for OFF_S."""

    def __init__(self, node: RosNode, speed: float) -> None:
        self._node, self._speed = node, speed
        self._started_at = 0.0
        self._starts = threading.Event()
        self._switch = node.publisher("/conveyor/switch", "std_msgs/Bool")
        node.subscribe("/line/started", "std_msgs/Float64", self._started)

    def _started(self, message: Any) -> None:
        self._started_at = float(message.data)
        self._starts.set()

    def run(self) -> None:
        """Work until told to stop."""
        report("operator", "is ready")
        while True:
            self._node.wait_until(self._starts.is_set)
            self._starts.clear()
            off_at = self._started_at + OFF_S / self._speed
            # A panel that comes back later finds the belt as it was left.
            if time.time() < off_at:
                self._switch(True)
                self._wait_until(off_at)
            if not self._starts.is_set():
                report("operator", "turns the conveyor off")
                self._switch(False)

    def _wait_until(self, moment: float) -> None:
        """Wait until a moment, or until the arm starts anew."""
        self._node.wait_until(lambda: time.time() >= moment or self._starts.is_set())


def main() -> None:
    """Run the panel until SIGTERM."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ros", type=int, choices=(1, 2), default=1)
    parser.add_argument("--speed", type=float, default=1.0)
    options = parser.parse_args()
    node = connect(options.ros, "operator_panel")
    try:
        OperatorPanel(node, options.speed).run()
    finally:
        node.close()


if __name__ == "__main__":
    main()
