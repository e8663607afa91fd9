# pyright: basic, reportMissingImports=false, reportPrivateImportUsage=false
"""A ROS 2 robot whose program speaks JSON, written from docs/skills-json.md: `ros2_carrier.py SPACE SKILL_ID`.

Prints `begun JOB`, `done JOB`, `refused JOB`.
"""

import json
import sys
import threading
import time
from typing import Any

import rclpy
from std_msgs.msg import String

from tests.ros2_spinning import spin_node
from tests.saying import say

rclpy.init()
node = rclpy.create_node("carrier")
space, skill = int(sys.argv[1]), int(sys.argv[2])
publisher = node.create_publisher(String, f"ua_{space}_2_{skill}", 10)
states: dict[str, dict[str, Any]] = {}


def tell(execution_id: str) -> None:
    state = states.get(execution_id, {"state": "unknown"})
    publisher.publish(String(data=json.dumps({"execution_id": execution_id, **state})))


def work(execution_id: str, job: int) -> None:
    time.sleep(job % 100 / 10)
    say(f"done {job}")
    states[execution_id] = {"state": "done", "results": {}}
    tell(execution_id)


def on_request(message: Any) -> None:
    request = json.loads(message.data)
    execution_id = request["execution_id"]
    if request.get("request", "execute") == "execute" and execution_id not in states:
        job = request["arguments"]["job"]
        say(f"{'refused' if job < 0 else 'begun'} {job}")
        if job < 0:
            states[execution_id] = {"state": "refused", "message": "it is too heavy for the carrier"}
        else:
            states[execution_id] = {"state": "running", "progress": 0.0}
            threading.Thread(target=work, args=(execution_id, job), daemon=True).start()
    tell(execution_id)


node.create_subscription(String, f"ua_0_2_{skill}", on_request, 10)
say("ready")
spin_node(node)
