# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false
"""A program that keeps itself registered: counts on a topic, says what it hears on another, and offers a service."""

import rospy
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger, TriggerResponse
from ua_bridges.robot.ros1_registered import keep_registered

from tests.saying import say

rospy.init_node("registered", disable_rosout=True)
keep_registered()
publisher = rospy.Publisher("/ua_1_2_7", Float64, queue_size=10)
rospy.Subscriber("/ua_2_2_5", String, lambda message: say(f"heard: {message.data}"))
rospy.Service("/serve", Trigger, lambda _: TriggerResponse(success=True))
say("ready")
count = 0
while not rospy.is_shutdown():
    publisher.publish(Float64(data=count))
    count += 1
    rospy.rostime.wallsleep(0.05)
