# pyright: basic, reportMissingImports=false
"""A stock ROS 1 node that does what the lines on its standard input say; see `harness.RobotProcess`."""

import json
import operator
import os
import sys
import threading
from collections.abc import Callable
from typing import Any

import roslib.message  # type: ignore[import-not-found]  # ROS 1 has no types, and is in no wheel
import rospy

lock = threading.Lock()


def say(**what: object) -> None:
    with lock:
        print(json.dumps(what), flush=True)


def fill(message: Any, values: dict[str, Any]) -> Any:
    for path, value in values.items():
        parent, _, name = path.rpartition(".")
        setattr(operator.attrgetter(parent)(message) if parent else message, name, value)
    return message


def cut(kind: Any) -> Any:
    """A message of which rospy sends no more than a byte."""

    class Cut(kind):  # type: ignore[misc]  # it is known when the program runs
        __slots__ = ()

        def serialize(self, buff: Any) -> None:
            buff.write(b"\xff")

    return Cut()


def listener(name: str, fields: list[str]) -> Callable[[Any], None]:
    return lambda message: say(heard=name, values={path: operator.attrgetter(path)(message) for path in fields})


rospy.init_node("robot", disable_rosout=True)
publishers: dict[str, Any] = {}
subscribers: list[Any] = []
say(done=True)
for line in sys.stdin:
    order = json.loads(line)
    name, topic = order["name"], f"/{order['name']}"
    if order["do"] == "advertise":
        publishers[name] = rospy.Publisher(topic, roslib.message.get_message_class(order["type"]), queue_size=100)
    elif order["do"] == "publish":
        if name in publishers:
            publishers[name].publish(fill(publishers[name].data_class(), order["values"]))
    elif order["do"] == "misbehave":
        publishers[name].publish(cut(publishers[name].data_class))
    elif order["do"] == "withdraw":
        publishers.pop(name).unregister()
    elif order["do"] == "subscribe":
        kind = roslib.message.get_message_class(order["type"])
        subscribers.append(rospy.Subscriber(topic, kind, listener(name, order["fields"])))
    say(done=True)
os._exit(0)  # its master goes as well, so there is nothing to sign off from
