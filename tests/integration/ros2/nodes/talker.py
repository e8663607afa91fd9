# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A stock ROS 2 node: publishes one topic, like `ros2 topic pub`.

    talker.py TOPIC TYPE JSON [--rate HZ] [--count N] [--best-effort] [--transient-local] [--depth N] [--wait]

`COUNT` in the JSON is replaced by the number of the message, `STAMP` by the time now in a Header's form.
"""

import argparse
import importlib
import json
import time
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

parser = argparse.ArgumentParser()
parser.add_argument("topic")
parser.add_argument("type")
parser.add_argument("json")
parser.add_argument("--rate", type=float, default=20.0)
parser.add_argument("--count", type=int, default=0, help="so many messages, then only stay")
parser.add_argument("--best-effort", action="store_true")
parser.add_argument("--transient-local", action="store_true")
parser.add_argument("--depth", type=int, default=10)
parser.add_argument("--wait", action="store_true", help="until there is a subscriber")
parser.add_argument("--name", default="talker")
args = parser.parse_args()


def fill(message: Any, values: dict[str, Any]) -> None:
    for name, value in values.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)


package, _, name = args.type.partition("/")
message_class = getattr(importlib.import_module(f"{package}.msg"), name)
rclpy.init()
node = rclpy.create_node(args.name)
qos = QoSProfile(
    depth=args.depth,
    reliability=ReliabilityPolicy.BEST_EFFORT if args.best_effort else ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL if args.transient_local else DurabilityPolicy.VOLATILE,
)
publisher = node.create_publisher(message_class, args.topic, qos)
print("ready", flush=True)
while args.wait and rclpy.ok() and publisher.get_subscription_count() == 0:
    time.sleep(0.01)
if args.wait:
    time.sleep(0.3)  # the other side has to match, too
number = 0
while rclpy.ok():
    if not args.count or number < args.count:
        stamp = time.time_ns()
        text = args.json.replace("COUNT", str(number))
        text = text.replace('"STAMP"', json.dumps({"sec": stamp // 10**9, "nanosec": stamp % 10**9}))
        message = message_class()
        fill(message, json.loads(text))
        publisher.publish(message)
        number += 1
        if number == args.count:
            print("published", flush=True)
    time.sleep(1 / args.rate)
