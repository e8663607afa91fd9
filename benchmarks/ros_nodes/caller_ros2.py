# pyright: basic, reportMissingImports=false
"""Calls the service `/bare` of ROS 2 one time after the other.

stdout: `ready`; stdin: `COUNT PAUSE_S`, answered with a JSON list of the monotonic times before each call.
"""

import json
import sys
import threading
import time

import rclpy
from std_srvs.srv import Trigger

from benchmarks.ros_nodes.spinning_ros2 import spinning


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("benchmark_caller")
    client = node.create_client(Trigger, "/bare")
    answered = threading.Event()

    def call() -> float:
        answered.clear()
        called = time.monotonic()
        client.call_async(Trigger.Request()).add_done_callback(lambda _: answered.set())
        if not answered.wait(10):
            raise TimeoutError("/bare does not answer")
        return called

    with spinning(node):
        if not client.wait_for_service(20):
            raise TimeoutError("nobody serves /bare")
        print("ready", flush=True)
        for line in sys.stdin:
            count, pause_s = line.split()
            times: list[float] = []
            for _ in range(int(count)):
                time.sleep(float(pause_s))
                times.append(call())
            print(json.dumps(times), flush=True)


main()
