# pyright: basic, reportMissingImports=false
"""A service of ROS 2 that gives a string back, or its caller.

    echo_ros2.py serve          stdout: `ready`; ends with stdin
    echo_ros2.py call           stdout: `ready`; stdin: `CHARACTERS COUNT PAUSE_S`, answered with a JSON list of the
                                microseconds of each round trip

ListParameters is the standard service type with strings in both directions.
"""

import json
import sys
import threading
import time
from typing import Any

import rclpy
from rcl_interfaces.srv import ListParameters

from benchmarks.ros_nodes.spinning_ros2 import spinning


def main(is_caller: bool) -> None:
    rclpy.init()
    node = rclpy.create_node("benchmark_echo_caller" if is_caller else "benchmark_echo")

    def echo(request: ListParameters.Request, response: ListParameters.Response) -> ListParameters.Response:
        response.result.names = request.prefixes
        return response

    if is_caller:
        client = node.create_client(ListParameters, "/benchmark_echo")
    else:
        node.create_service(ListParameters, "/benchmark_echo", echo)
    answered = threading.Event()

    def call(text: str) -> float:
        answered.clear()
        called = time.perf_counter()
        future = client.call_async(ListParameters.Request(prefixes=[text]))
        future.add_done_callback(lambda _: answered.set())
        answer: Any = future.result() if answered.wait(10) else None
        if answer is None or answer.result.names != [text]:
            raise RuntimeError("the service has not given back what it got")
        return round((time.perf_counter() - called) * 1e6, 1)

    with spinning(node):
        if is_caller and not client.wait_for_service(20):
            raise TimeoutError("nobody serves /benchmark_echo")
        print("ready", flush=True)
        for line in sys.stdin:
            characters, count, pause_s = line.split()
            times: list[float] = []
            for number in range(int(count)):
                time.sleep(float(pause_s))
                times.append(call(chr(97 + number % 26) * int(characters)))
            print(json.dumps(times), flush=True)


main(sys.argv[1] == "call")
