# pyright: basic, reportMissingImports=false
"""A stock ROS 1 node: publishes one topic, like `rostopic pub`.

    talker.py TOPIC TYPE YAML [--rate HZ] [--latch] [--count N] [--name NODE] [--wait]

`COUNT` in the YAML is replaced by the number of the message.
"""

import argparse
import signal
import time

import genpy.message
import rospy
import yaml

parser = argparse.ArgumentParser()
parser.add_argument("topic")
parser.add_argument("type")
parser.add_argument("yaml")
parser.add_argument("--rate", type=float, default=20.0)
parser.add_argument("--latch", action="store_true")
parser.add_argument("--count", type=int, default=0, help="so many messages, then only stay")
parser.add_argument("--name", default="talker")
parser.add_argument("--wait", action="store_true", help="until there is a subscriber")
args = parser.parse_args()

# rospy's own handler of signals waits for locks that the publishing in its midst may hold, and then for ever.
ended: list[object] = []
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda which, _: ended.append(which))


def rest(until_s: float) -> None:
    """Sleep until then, or until this is to end."""
    while not ended and (left_s := until_s - time.monotonic()) > 0:
        time.sleep(min(left_s, 0.05))


rospy.init_node(args.name, disable_rosout=True, disable_signals=True)
message_class = genpy.message.get_message_class(args.type)
publisher = rospy.Publisher(args.topic, message_class, queue_size=1000, latch=args.latch)
print("ready", flush=True)
while args.wait and publisher.get_num_connections() == 0 and not ended:
    time.sleep(0.01)
due_s = time.monotonic()
published = 0
while not ended:
    if args.count and published >= args.count:
        print("published", flush=True)
        rest(float("inf"))
        break
    message = message_class()
    genpy.message.fill_message_args(message, [yaml.safe_load(args.yaml.replace("COUNT", str(published)))])
    publisher.publish(message)
    published += 1
    due_s = max(due_s + 1 / args.rate, time.monotonic() - 1)
    rest(due_s)
rospy.signal_shutdown("ended")
