# pyright: basic, reportMissingImports=false
"""A stock ROS 2 node that does what the lines on its standard input say; see `harness.RobotProcess`."""

import importlib
import json
import operator
import sys
import threading
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

QOS = QoSProfile(depth=100)
lock = threading.Lock()


def say(**what: object) -> None:
    with lock:
        print(json.dumps(what), flush=True)


def class_of(ros_type: str) -> Any:
    package, _, name = ros_type.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def fill(message: Any, values: dict[str, Any]) -> Any:
    for path, value in values.items():
        parent, _, name = path.rpartition(".")
        setattr(operator.attrgetter(parent)(message) if parent else message, name, value)
    return message


def listener(name: str, fields: list[str]) -> Callable[[Any], None]:
    return lambda message: say(heard=name, values={path: operator.attrgetter(path)(message) for path in fields})


rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # else a SIGTERM would not end the loop below
node = rclpy.create_node("robot")
executor = SingleThreadedExecutor()
executor.add_node(node)
threading.Thread(target=executor.spin, daemon=True).start()
publishers: dict[str, Any] = {}
subscriptions: list[Any] = []
say(done=True)
for line in sys.stdin:
    order = json.loads(line)
    name, topic = order["name"], f"/{order['name']}"
    if order["do"] == "advertise":
        publishers[name] = node.create_publisher(class_of(order["type"]), topic, QOS)
    elif order["do"] == "publish":
        if name in publishers:
            publishers[name].publish(fill(publishers[name].msg_type(), order["values"]))
    elif order["do"] == "misbehave":
        publishers[name].publish(b"\x00\x01\x00\x00\xff")
    elif order["do"] == "withdraw":
        node.destroy_publisher(publishers.pop(name))
    elif order["do"] == "subscribe":
        kind = class_of(order["type"])
        subscriptions.append(node.create_subscription(kind, topic, listener(name, order["fields"]), QOS))
    say(done=True)
executor.shutdown()
node.destroy_node()
rclpy.shutdown()
