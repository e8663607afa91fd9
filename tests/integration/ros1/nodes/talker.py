# pyright: basic, reportMissingImports=false
"""A stock ROS 1 node: publishes one topic, like `rostopic pub`.

    talker.py TOPIC TYPE YAML [--rate HZ] [--latch] [--count N] [--name NODE] [--wait]

`COUNT` in the YAML is replaced by the number of the message.
"""

import argparse
import sys

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

rospy.init_node(args.name, disable_rosout=True)
message_class = genpy.message.get_message_class(args.type)
publisher = rospy.Publisher(args.topic, message_class, queue_size=1000, latch=args.latch)
print("ready", flush=True)
while args.wait and publisher.get_num_connections() == 0 and not rospy.is_shutdown():
    rospy.sleep(0.01)
rate = rospy.Rate(args.rate)
number = 0
while not rospy.is_shutdown():
    if args.count and number >= args.count:
        print("published", flush=True)
        rospy.spin()
        sys.exit()
    message = message_class()
    genpy.message.fill_message_args(message, [yaml.safe_load(args.yaml.replace("COUNT", str(number)))])
    publisher.publish(message)
    number += 1
    rate.sleep()
