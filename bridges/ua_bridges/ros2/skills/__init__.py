"""Skills of robots in ROS 2: topics, services, actions, and robots' own programs.

The event loop's side checks and hands over; the node's thread works with the ports, one for each skill
(`ua_bridges.ros.ports`).
"""
