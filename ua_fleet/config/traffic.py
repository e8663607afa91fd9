"""What `fleet.yaml` tells of the kinds of messages that do not show it themselves."""

from __future__ import annotations

from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import Topic
from ua_fleet.traffic import MessageKind

__all__ = ["known_kinds"]


def known_kinds(config: FleetConfig) -> dict[Topic, MessageKind]:
    """Where robots announce faults, and the data of sensors: of what has data and can be asked for nothing."""
    known: dict[Topic, MessageKind] = {}
    for robot in config.robots.values():
        space, ns = config.bridges[robot.bridge].space, robot.namespace
        if robot.fault_id is not None:
            known[Topic(space, ns, robot.fault_id)] = MessageKind.FAULT
        if not robot.skills:
            sources = [data.id for data in robot.data.values() if data.origin == "robot" and data.id is not None]
            known |= {Topic(space, ns, number): MessageKind.SENSOR for number in sources}
    return known
