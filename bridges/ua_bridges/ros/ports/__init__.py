"""Ports: how a ROS bridge does skills. What is the same in ROS 1 and ROS 2 stands here, without any ROS library."""

from ua_bridges.ros.ports.action import ActionPort, Goal
from ua_bridges.ros.ports.driver import SkilledDriver, port_maker
from ua_bridges.ros.ports.port import APPEARS_S, Listened, LoadedType, SkillGraph, SkillPort, Spoken
from ua_bridges.ros.ports.service import ServicePort
from ua_bridges.ros.ports.skills import RobotSkills

__all__ = [
    "APPEARS_S",
    "ActionPort",
    "Goal",
    "Listened",
    "LoadedType",
    "RobotSkills",
    "ServicePort",
    "SkillGraph",
    "SkillPort",
    "SkilledDriver",
    "Spoken",
    "port_maker",
]
