# pyright: basic, reportMissingImports=false
"""The topics of a running ROS 2 domain, for `ua-fleet config add-topics`."""

from __future__ import annotations

import time
from typing import Any, Final

from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.offered import ROS_TOPICS, offered_fields
from ua_bridges.ros2.classes import TypeMissing, load_type
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.node import leave, make_node
from ua_fleet.config.schema import BridgeConfig
from ua_fleet.config.topics_seen import TopicSeen

__all__ = ["topics_seen"]

_NODE: Final = "ua_fleet_config"
_LOOK_S: Final = 0.1


def topics_seen(config: BridgeConfig, within_s: float) -> list[TopicSeen]:
    """All topics that foreign nodes publish or subscribe to.

    Args:
        config: of the bridge.
        within_s: how long others are looked for: nobody says when all are found.

    Raises:
        BridgeUnavailable: rclpy is not installed, or does not start.
    """
    assert isinstance(config, Ros2BridgeConfig)
    context, node = make_node(config.space, _NODE, config.discovery)
    try:
        until = time.monotonic() + within_s
        while (left := until - time.monotonic()) > 0:
            time.sleep(min(left, _LOOK_S))
        own = {_NODE, config.node_name, f"{config.node_name}_skills"}
        seen = [_seen(node, topic, types, own) for topic, types in node.get_topic_names_and_types()]
        return [one for one in seen if one is not None]
    finally:
        leave(context, node)


def _seen(node: Any, topic: str, types: list[str], own: set[str]) -> TopicSeen | None:
    if topic in ROS_TOPICS:
        return None
    publishers = [one for one in node.get_publishers_info_by_topic(topic) if one.node_name not in own]
    subscribers = [one for one in node.get_subscriptions_info_by_topic(topic) if one.node_name not in own]
    if not publishers and not subscribers:
        return None
    from rclpy.qos import DurabilityPolicy

    is_latched = bool(publishers) and all(
        one.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for one in publishers
    )
    kind, is_command = types[0].replace("/msg/", "/"), not publishers
    if len(types) > 1:
        return TopicSeen(topic, kind, is_command, problem=f"it has several types: {', '.join(types)}")
    try:
        fields = offered_fields(load_type(kind).schema)
    except (TypeMissing, SchemaInvalid) as error:
        return TopicSeen(topic, kind, is_command, problem=str(error))
    return TopicSeen(topic, kind, is_command, fields, is_latched)
