"""Skills of robots in ROS 1: topics, services, actionlib, and robots' own programs.

A thread of their own works with the ports (`ua_bridges.ros.ports`); what rospy hears, and what the threads of service
calls bring, is put into it. Nothing in it waits for a robot or for the master.
"""
