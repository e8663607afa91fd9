# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A robot that announces a fault at SIGUSR1, its repair at SIGUSR2: `faulty.py ros1|ros2 SPACE FAULT_ID [CAPACITY]`."""

import signal
import sys
import threading
from typing import Any

SIGNALS = {signal.SIGUSR1, signal.SIGUSR2}
library, space, fault_id = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)


def in_ros1() -> Any:
    import rospy
    from ua_bridges.robot.ros1 import Robot

    rospy.init_node("faulty", disable_signals=True)
    return Robot(fault_id=fault_id)


def in_ros2() -> Any:
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    from ua_bridges.robot.ros2 import Robot

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # whose handlers would leave SIGTERM to nobody
    node = rclpy.create_node("faulty")
    threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
    return Robot(node, space=space, fault_id=fault_id)


robot = in_ros1() if library == "ros1" else in_ros2()
print("ready", flush=True)
while True:
    if signal.sigwait(SIGNALS) == signal.SIGUSR1:
        robot.fault("".join(f"{capacity}: " for capacity in sys.argv[4:]) + "motor\noverheated")
    else:
        robot.repaired()
