# pyright: basic, reportMissingImports=false
"""The other robot of the load benchmark: a rospy node that takes serialised messages.

load_subscriber_ros1.py STREAM=TOPIC...
"""

import struct
import sys

import rospy

from benchmarks.ros_nodes.load_streams import Arrivals


def main() -> None:
    rospy.init_node("load_subscriber", disable_rosout=True, disable_signals=True)
    arrivals = Arrivals(struct.Struct("<II"), 4)

    def subscribe(topic: str) -> None:
        def heard(message: rospy.AnyMsg) -> None:
            arrivals.heard(topic, message._buff)

        rospy.Subscriber(topic, rospy.AnyMsg, heard, buff_size=1 << 20, tcp_nodelay=True)

    for each in sys.argv[1:]:
        subscribe(each.split("=")[1])
    arrivals.serve()
    rospy.signal_shutdown("done")


main()
