"""The topics of a running ROS 1 graph, for `ua-fleet config add-topics`. Needs no rospy: the master and the publishers
are asked, and nothing is registered.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Iterable
from typing import Final

from ua_bridges.ros.errors import SchemaInvalid
from ua_bridges.ros.installed import schema_of
from ua_bridges.ros.offered import ROS_TOPICS, action_topics, offered_fields
from ua_bridges.ros.schema import schema_from_definition
from ua_bridges.ros1.config import Ros1BridgeConfig
from ua_bridges.ros1.master import RosMaster
from ua_bridges.ros1.tcpros import Broken, read_header, topic_address, write_header
from ua_fleet.config.schema import BridgeConfig
from ua_fleet.config.topics_seen import TopicSeen

__all__ = ["topics_seen"]

_CALLER: Final = "/ua_fleet_config"
_ANSWER_S: Final = 2.0
"""For one publisher."""
_UNKNOWN: Final = "*"


def topics_seen(config: BridgeConfig, within_s: float) -> list[TopicSeen]:
    """All topics that foreign nodes publish or subscribe to.

    Args:
        config: of the bridge.
        within_s: not needed: the master knows all.

    Raises:
        NotConnected: there is no master.
    """
    del within_s
    assert isinstance(config, Ros1BridgeConfig)
    master = RosMaster(config.master_uri, _CALLER)
    try:
        state, types = master.system_state(), master.topic_types()
        own = {f"/{config.node_name}"}
        actions = action_topics(types.items())
        found: list[TopicSeen] = []
        for topic in sorted({*state.publishers, *state.subscribers} - ROS_TOPICS):
            publishers = [node for node in state.publishers.get(topic, ()) if node not in own]
            subscribers = [node for node in state.subscribers.get(topic, ()) if node not in own]
            if not publishers and not subscribers:
                continue
            kind = types.get(topic, _UNKNOWN)
            if topic in actions:
                text = f"belongs to the action {actions[topic]}; make a skill of it"
                found.append(TopicSeen(topic, kind, not publishers, problem=text))
            else:
                uris = [uri for node in publishers if (uri := master.node_uri(node)) is not None]
                found.append(_seen(topic, kind, uris, is_command=not publishers))
        return found
    finally:
        master.close()


def _seen(topic: str, kind: str, publishers: Iterable[str], *, is_command: bool) -> TopicSeen:
    definition, is_latched = "", False
    for uri in publishers:
        try:
            header = _header(uri, topic)
        except (Broken, OSError):
            continue
        kind, definition = header.get("type", kind), header.get("message_definition", "")
        is_latched = header.get("latching") == "1"
        break
    if kind == _UNKNOWN:
        return TopicSeen(topic, kind, is_command, problem="nobody says its type")
    try:
        schema = schema_from_definition(kind, definition) if definition else schema_of(kind, 1)
    except SchemaInvalid as error:
        return TopicSeen(topic, kind, is_command, problem=str(error))
    if schema is None:
        package = kind.partition("/")[0].replace("_", "-")
        return TopicSeen(topic, kind, is_command, problem=f"{kind} is not installed here; install python3-{package}")
    return TopicSeen(topic, kind, is_command, offered_fields(schema), is_latched)


def _header(uri: str, topic: str) -> dict[str, str]:
    """What a publisher says of its topic, as to a subscriber that takes any type and leaves at once."""
    deadline = time.monotonic() + _ANSWER_S
    address = topic_address(uri, _CALLER, topic, deadline)
    with socket.create_connection(address, max(deadline - time.monotonic(), 0.001)) as link:
        asked = {"callerid": _CALLER, "topic": topic, "type": "*", "md5sum": "*", "message_definition": ""}
        write_header(link, asked, deadline)
        return read_header(link, deadline)
