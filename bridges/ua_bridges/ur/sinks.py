"""DataSets that are written to the controller's outputs: clients' data, and that of other spaces' robots. Pure."""

from __future__ import annotations

from ua_bridges.ur.config import UrBridgeConfig, UrSink
from ua_bridges.ur.outputs import Output, find_output
from ua_fleet.bridge.configured import configured_sinks
from ua_fleet.config.schema import FleetConfig
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.topics import Topic

__all__ = ["sinks_of"]


def sinks_of(config: FleetConfig, bridge_name: str) -> dict[Topic, tuple[FieldOrder, Output]]:
    """Which output each DataSet sets at the controller of a bridge, and where its value stands in a message.

    One that has no id yet is left out.
    """
    bridge = config.bridges[bridge_name]
    assert isinstance(bridge, UrBridgeConfig)
    found = {
        data.topic: (data.order, find_output(data.side.output))
        for data in configured_sinks(config, bridge_name, UrSink, mirrors=bridge.mirrors)
    }
    return {topic: (order, output) for topic, (order, output) in found.items() if output is not None}
