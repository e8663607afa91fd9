"""The fault-tolerant product assembly line (PAL) of Nguyen et al., ONCON 2022, section V.

A Niryo Ned arm (ROS 1) places covers on a conveyor belt that is wired to it. When the belt stops, a TurtleBot3
(ROS 2, domain 2) carries them instead. A human assembles. The two robots' programs choreograph by the states of the
park and of the bucket alone, which reach the arm through both UA bridges.
"""
