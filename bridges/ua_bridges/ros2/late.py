# pyright: basic, reportMissingImports=false
"""Values that the bridge before this one had published, for subscribers that come after it. All in the node's thread.

After a restart the robots that were there have the last value of every topic, and must not get it again. A robot that
comes later and asks for TRANSIENT_LOCAL must get it. DDS cannot send to one subscriber only; but a participant that
publishes before it has discovered anybody is heard by no VOLATILE subscriber, since for those that is the past. So the
first late subscriber makes us publish the value through a participant of its own. What remains: a robot that was there
and asks for TRANSIENT_LOCAL gets the value a second time then, as from any ROS 2 node that is restarted.
"""

from __future__ import annotations

from typing import Any, Final

from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.node import Ros2Node, leave, make_node, make_profile
from ua_bridges.ros2.qos import MIRROR

__all__ = ["LateSubscribers"]

_SETTLE_S: Final = 1.0
"""Subscribers that are discovered so soon after our start were there before it."""


class _Kept:
    """A value that nobody needs yet."""

    def __init__(self, message_class: Any, message: Any) -> None:
        self.message_class, self.message = message_class, message
        self.present: set[bytes] = set()


class LateSubscribers:
    """Publishes kept values when a late subscriber needs them."""

    def __init__(self, config: Ros2BridgeConfig) -> None:
        self._config = config
        self._settled_at = 0.0
        self._kept: dict[str, _Kept] = {}
        self._published: dict[str, tuple[Any, Any]] = {}
        """Node and publisher of each value that was needed."""
        self._participants: list[tuple[Any, Any]] = []

    def opened(self, now: float) -> None:
        """The bridge's node is there."""
        self._settled_at = now + _SETTLE_S

    def keep(self, node: Ros2Node, name: str, message_class: Any, message: Any) -> None:
        """Keep the last message of a topic, published by the bridge before this one."""
        kept = self._kept[name] = _Kept(message_class, message)
        kept.present = self._subscribers(node, name)

    @staticmethod
    def _subscribers(node: Ros2Node, name: str) -> set[bytes]:
        return {s.offer.gid for s in node.subscribers(name) if s.offer.transient_local and not s.own}

    def forget(self, name: str) -> None:
        """There is a newer message."""
        self._kept.pop(name, None)
        published = self._published.pop(name, None)
        if published is not None:
            node, publisher = published
            node.destroy_publisher(publisher)

    def look(self, node: Ros2Node, now: float) -> None:
        """Look for late subscribers; to be called a few times a second."""
        needed: list[str] = []
        for name, kept in self._kept.items():
            gids = self._subscribers(node, name)
            if now < self._settled_at:
                kept.present |= gids
            elif gids - kept.present:
                needed.append(name)
        if needed:
            self._publish(needed)

    def _publish(self, names: list[str]) -> None:
        config = self._config
        context, node = make_node(config.space, f"{config.node_name}_late", config.discovery)
        for name in names:  # at once: in some milliseconds the participant will be known, and heard by everybody
            kept = self._kept.pop(name)
            publisher = node.create_publisher(kept.message_class, name, make_profile(MIRROR))
            publisher.publish(kept.message)
            self._published[name] = node, publisher
        self._participants.append((context, node))

    def close(self) -> None:
        """Leave the domain."""
        self._kept.clear()
        self._published.clear()
        for context, node in self._participants:
            leave(context, node)
        self._participants.clear()
