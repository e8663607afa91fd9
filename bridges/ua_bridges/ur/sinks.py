"""DataSets that are written to the controller's outputs: clients' data, and that of other spaces' robots. Pure."""

from __future__ import annotations

from ua_bridges.ur.config import UrBridgeConfig, UrSink
from ua_bridges.ur.outputs import SPEEDS, Output, find_output
from ua_bridges.ur.speeding import Speeding
from ua_fleet.bridge.configured import configured_sinks
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.teleoperation import teleoperations
from ua_fleet.fleet.matching import FieldOrder
from ua_fleet.topics import Topic

__all__ = ["sinks_of", "speeds_of"]


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


def speeds_of(config: FleetConfig, bridge_name: str) -> dict[Topic, Speeding]:
    """The arm that is driven by hand, by the data that takes its setpoints."""
    models = {model.data: model for model in teleoperations(config, bridge_name)}
    return {
        data.topic: Speeding(
            models[data.topic],
            data.side.output,
            [field.path or name for name, field in data.config.all_fields().items()],
        )
        for data in configured_sinks(config, bridge_name, UrSink)
        if data.topic in models and data.side.output in SPEEDS
    }
