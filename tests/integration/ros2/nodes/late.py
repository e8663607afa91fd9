# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A bridge's values for late subscribers, in a process that is kept waiting once its participant is there.

late.py DOMAIN TOPIC WAITS: once it has a subscriber it keeps 7, publishes that when one comes that is owed it, and 8
after that. The first WAITS participants for the 7 are known to the subscriber before it is published.
"""

import signal
import sys
import time
from typing import Any

from std_msgs.msg import Int32
from ua_bridges.ros.served import Served
from ua_bridges.ros2 import late
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.node import Ros2Node, make_profile
from ua_bridges.ros2.qos import MIRROR

domain, topic, waits = int(sys.argv[1]), sys.argv[2], int(sys.argv[3])
patched: Any = late
make_node, joined = patched.make_node, list[Any]()


def make_node_and_wait(*given: Any) -> tuple[Any, Any]:
    context, node = make_node(*given)
    joined.append(node)
    while len(joined) <= waits and not node.count_subscribers(topic):
        time.sleep(0.01)
    return context, node


patched.make_node = make_node_and_wait
config = Ros2BridgeConfig.model_validate({"kind": "ros2", "space": domain, "status_id": 1})
bridge = Ros2Node(domain, config.node_name, config.discovery)
publisher = bridge.node.create_publisher(Int32, topic, make_profile(MIRROR))
kept = late.LateSubscribers(config, Served(None))
print("ready", flush=True)
while not bridge.count_subscribers(topic):
    time.sleep(0.01)
kept.watch(bridge, topic)
kept.keep(topic, Int32, Int32(data=7))
while not joined:
    kept.look(bridge)
    time.sleep(0.01)
print(f"participants {len(joined)}", flush=True)
publisher.publish(Int32(data=8))
signal.pause()
