"""Data that clients, or other spaces, write to the controller's outputs. Pure."""

from __future__ import annotations

from ua_bridges.ur.config import UrSink
from ua_bridges.ur.outputs import Output, find_output
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import SERVER_SPACE, Topic

__all__ = ["sinks_of"]


def sinks_of(config: FleetConfig, bridge_name: str) -> dict[Topic, Output]:
    """Which output each DataSet of the server sets, for the robot behind a bridge."""
    found: dict[Topic, Output] = {}
    for robot in config.robots.values():
        if robot.bridge != bridge_name:
            continue
        for data in robot.data.values():
            output = find_output(data.sink.output) if isinstance(data.sink, UrSink) else None
            if output is not None and data.id is not None:
                found[Topic(SERVER_SPACE, config.fleet.namespace_index, data.id)] = output
    return found
