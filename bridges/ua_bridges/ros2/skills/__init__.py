"""Skills of robots in ROS 2: topics, services, actions, and robots' own programs.

`driver_part.RobotSkills` is what the driver has of them: the event loop's side checks and hands over, the node's thread
works with the ports, one for each skill (`port.SkillPort`).
"""
