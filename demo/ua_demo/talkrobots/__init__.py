"""The nine-task demonstration of TalkRoBots: Ayaida et al., Future Internet 2022, section 6.1.

Ridgeback with Sawyer (ROS 1), UR3, two Pioneers and a temperature sensor (ROS 2), a Parrot drone (a TCP socket) and a
conveyor (a PLC with Modbus) have a bridge each, so that every hand-over crosses the network. Ridgeback fails in its
fourth task, and another robot, chosen by the Analytic Hierarchy Process, drives in its place; its arm works on.
"""
