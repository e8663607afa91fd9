"""What the drivers of ROS 1 and ROS 2 have in common: the event loop's side of what is published."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

from ua_bridges.ros.form import named_types
from ua_bridges.ros.outlets import Outlets
from ua_bridges.ros.topic_mapping import TopicMapping
from ua_fleet.bridge.configured import configured_sinks, configured_sources
from ua_fleet.bridge.driver import Driver, Dropped, Inlet
from ua_fleet.config.schema import FleetConfig
from ua_fleet.config.teleoperation import teleoperations
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic
from ua_fleet.wire.messages import DataSetMessage, DataSetMetaData

__all__ = ["RosDriver"]


class RosDriver(Driver):
    """A driver of either ROS. `start` sets `_inlet` and `_outlets`."""

    takes_packed_arrays: ClassVar[bool] = True
    _inlet: Inlet
    _outlets: Outlets[Any] | None

    def __init__(self, config: FleetConfig, bridge_name: str) -> None:
        self._sources = configured_sources(config, bridge_name, TopicMapping)
        self._sinks = configured_sinks(config, bridge_name, TopicMapping)
        self._driven = {model.data for model in teleoperations(config, bridge_name)}
        self._named = named_types(config)
        self._outlets = None

    @property
    @abstractmethod
    def _has_node(self) -> bool:
        """Whether the bridge's node is there, so that what has a link can be written to."""

    @property
    @abstractmethod
    def _is_in_graph(self) -> bool:
        """Whether others find that node in the graph."""

    def _add_sinks(self, outlets: Outlets[Any]) -> None:
        """Write to the robots' own topics what `fleet.yaml` says."""
        for data in self._sinks:
            outlets.add_sink(data, takes_setpoints=data.topic in self._driven)

    def publish(self, topic: Topic, metadata: DataSetMetaData, message: DataSetMessage) -> bool:
        """See Driver."""
        if self._outlets is None or not self._is_in_graph:
            self._inlet.put(Dropped(Drop.NOT_CONNECTED, detail=self.status().detail))
            return False
        return self._outlets.publish(topic, metadata, message)

    def setpoint_problem(self, topic: Topic) -> str:
        """See Driver."""
        if self._outlets is None or not self._is_in_graph:
            return f"the bridge is not in ROS: {self.status().detail}"
        return self._outlets.setpoint_problem(topic)

    def write_setpoint(self, topic: Topic, values: tuple[float, ...]) -> None:
        """See Driver. A node that another one has taken the name of has its links, and is the only one to stop it."""
        if self._outlets is None or not self._has_node:
            self._inlet.put(Dropped(Drop.NOT_CONNECTED))
        else:
            self._outlets.write_setpoint(topic, values)
