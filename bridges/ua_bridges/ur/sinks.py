"""DataSets that are written to the controller's outputs: clients' data, and that of other spaces' robots. Pure."""

from __future__ import annotations

from ua_bridges.ur.config import UrBridgeConfig, UrSink
from ua_bridges.ur.outputs import Output, find_output
from ua_fleet.config.schema import FleetConfig
from ua_fleet.topics import SERVER_SPACE, Topic

__all__ = ["sinks_of"]


def sinks_of(config: FleetConfig, bridge_name: str) -> dict[Topic, Output]:
    """Which output each DataSet sets at the controller of a bridge. One that has no id yet is left out."""
    bridge = config.bridges[bridge_name]
    assert isinstance(bridge, UrBridgeConfig)
    found: dict[Topic, Output] = {}
    for name, robot in config.robots.items():
        for data_name, data in robot.data.items():
            sink = data.sink if robot.bridge == bridge_name else bridge.mirrors.get(f"{name}.{data_name}")
            output = find_output(sink.output) if isinstance(sink, UrSink) else None
            if output is not None and data.id is not None:
                space = SERVER_SPACE if data.origin == "server" else config.space_of(name)
                found[Topic(space, config.fleet.namespace_index, data.id)] = output
    return found
