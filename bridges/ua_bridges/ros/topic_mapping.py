"""`source` and `sink` of data on a ROS bridge: a robot's own topic."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from ua_fleet.config.base import Model
from ua_fleet.config.schema import TOPIC_NAME, DataMapping, MessageTypeName

__all__ = ["QosConfig", "TopicMapping", "absolute"]


class QosConfig(Model, frozen=True):
    """ROS 2 quality of service of a mapped topic. What is left out follows the publishers that are there."""

    reliability: Literal["reliable", "best_effort"] | None = None
    """Whether lost messages are sent again. A sink without it is `reliable`."""
    durability: Literal["volatile", "transient_local"] | None = None
    """Whether late subscribers get the last messages too. A sink without it is `volatile`."""
    depth: int = Field(default=10, ge=1, le=10_000)
    """Messages that the queue holds."""


class TopicMapping(DataMapping, frozen=True):
    """A robot's own topic that a DataSet is read from or written to. For the bridges of ROS 1 and ROS 2."""

    topic: Annotated[str, Field(pattern=TOPIC_NAME, examples=["/battery_state"])]
    """Name of the topic in the robot's space, e.g. `/battery_state`."""
    type: MessageTypeName
    """Message type as `pkg/Name`."""
    max_rate_hz: float | None = Field(default=None, gt=0)
    """At most so many messages a second are carried; the latest wins, and the last one always arrives."""
    latched: bool = False
    """ROS 1: publish latched. In ROS 2 use `qos.durability: transient_local`."""
    qos: QosConfig = QosConfig()
    """ROS 2 only: quality of service."""

    @property
    def own_topic(self) -> str:
        """See DataMapping."""
        return absolute(self.topic)

    @property
    def message_type(self) -> str:
        """See DataMapping."""
        return self.type.replace("/msg/", "/")


def absolute(topic: str) -> str:
    """The full name of a topic, a service or an action, with its slash."""
    return topic if topic.startswith("/") else f"/{topic}"
