# pyright: basic, reportMissingImports=false
"""A stock ROS 1 node: prints one topic's messages, like `rostopic echo`, each on one line.

listener.py TOPIC TYPE [--name NODE] [--loses-link]

With --loses-link it loses its first link, as rospy does after an outage: it closes it, and makes no other by itself.
"""

import argparse
import threading

import genpy.message
import rospy

from tests.saying import say

parser = argparse.ArgumentParser()
parser.add_argument("topic")
parser.add_argument("type")
parser.add_argument("--name", default="listener")
parser.add_argument("--loses-link", action="store_true")
args = parser.parse_args()


def heard(message: genpy.Message) -> None:
    text = " ".join(genpy.message.strify_message(message).split())
    latched = " latched" if message._connection_header.get("latching") == "1" else ""
    say(f"heard{latched}: {text}")


rospy.init_node(args.name, disable_rosout=True)
subscriber = rospy.Subscriber(args.topic, genpy.message.get_message_class(args.type), heard)
say("ready")


def tell_links() -> None:
    links = 0
    while not rospy.is_shutdown():
        if subscriber.get_num_connections() != links:
            links = subscriber.get_num_connections()
            say(f"links {links}")
            if links and args.loses_link:
                args.loses_link = False
                subscriber.impl.connections[0].close()
        rospy.sleep(0.02)


threading.Thread(target=tell_links, daemon=True).start()
rospy.spin()
