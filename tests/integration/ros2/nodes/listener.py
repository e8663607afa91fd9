# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A stock ROS 2 node: prints one topic's messages, like `ros2 topic echo`, each on one line.

listener.py TOPIC TYPE [--best-effort] [--transient-local] [--name NODE] [--meet NODE]
"""

import argparse
import importlib
import time

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from tests.ros2_spinning import spin_node

parser = argparse.ArgumentParser()
parser.add_argument("topic")
parser.add_argument("type")
parser.add_argument("--best-effort", action="store_true")
parser.add_argument("--transient-local", action="store_true")
parser.add_argument("--name", default="listener")
parser.add_argument("--meet", default="", help="get ready when this node is known; by then it knows us")
args = parser.parse_args()
package, _, name = args.type.partition("/")
rclpy.init()
node = rclpy.create_node(args.name)
qos = QoSProfile(
    depth=100,
    reliability=ReliabilityPolicy.BEST_EFFORT if args.best_effort else ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL if args.transient_local else DurabilityPolicy.VOLATILE,
)
callbacks = SubscriptionEventCallbacks(matched=lambda event: print(f"publishers {event.current_count}", flush=True))
node.create_subscription(
    getattr(importlib.import_module(f"{package}.msg"), name),
    args.topic,
    lambda message: print(f"heard: {message}", flush=True),
    qos,
    event_callbacks=callbacks,
)
while args.meet and args.meet not in node.get_node_names():
    time.sleep(0.01)
print("ready", flush=True)
spin_node(node)
