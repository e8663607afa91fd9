# pyright: basic, reportMissingImports=false
"""Values that the bridge before this one had published, for subscribers that it had not served; in the node's thread.

After a restart the robots that were there have the last value of every topic, and must not get it again. A robot that
is new and asks for TRANSIENT_LOCAL must get it. DDS cannot send to one subscriber only; but a participant that
publishes before it has discovered anybody is heard by no VOLATILE subscriber, since for those that is the past. So the
first new subscriber makes us publish the value through a participant of its own; one that has discovered somebody
meanwhile, since this process was kept waiting, is left for another. What remains: a robot that was there and asks for
TRANSIENT_LOCAL gets the value a second time then, as from any ROS 2 node that is restarted.
"""

from __future__ import annotations

from typing import Any, Final

import structlog

from ua_bridges.ros.served import Served
from ua_bridges.ros2.config import Ros2BridgeConfig
from ua_bridges.ros2.node import Ros2Node, leave, make_node, make_profile
from ua_bridges.ros2.qos import MIRROR

__all__ = ["LateSubscribers"]

_MORE_PARTICIPANTS: Final = 4
"""How many are tried, one after the other, in place of one that a subscriber knows before the value is published."""

_log = structlog.get_logger("ua_bridges.ros2")


class LateSubscribers:
    """Publishes kept values when a new subscriber needs them, and notes whom the bridge serves."""

    def __init__(self, config: Ros2BridgeConfig, served: Served) -> None:
        self._config = config
        self._served = served
        self._counts: dict[str, int] = {}
        """How many subscribers each watched topic had at the last look."""
        self._kept: dict[str, tuple[Any, Any]] = {}
        """Class and message of each value that nobody needs yet."""
        self._published: dict[str, tuple[Any, Any]] = {}
        """Node and publisher of each value that was needed."""
        self._participants: list[tuple[Any, Any]] = []

    def watch(self, node: Ros2Node, name: str) -> None:
        """Note whom a topic of the bridge serves, from now on."""
        self._counts[name] = 0
        self._look_at(node, name)

    def unwatch(self, name: str) -> None:
        """The bridge publishes the topic no more."""
        self._counts.pop(name, None)
        self.forget(name)

    def keep(self, name: str, message_class: Any, message: Any) -> None:
        """Keep the last message of a topic, published by the bridge before this one."""
        self._kept[name] = message_class, message

    def forget(self, name: str) -> None:
        """There is a newer message."""
        self._kept.pop(name, None)
        published = self._published.pop(name, None)
        if published is not None:
            node, publisher = published
            node.destroy_publisher(publisher)

    def look(self, node: Ros2Node) -> None:
        """Look for new subscribers; to be called a few times a second."""
        needed = [name for name in self._counts if self._look_at(node, name)]
        if needed:
            self._publish(needed)

    def _look_at(self, node: Ros2Node, name: str) -> bool:
        """Note the subscribers of a topic; whether a kept value is owed to one of them."""
        is_kept = name in self._kept
        count = node.count_subscribers(name)
        if count == self._counts[name] and not is_kept:
            return False
        self._counts[name] = count
        gids = [s.offer.gid for s in node.subscribers(name) if s.offer.transient_local and not s.own]
        is_owed = is_kept and not all(map(self._served.before, gids))
        for gid in gids:
            self._served.note(gid)
        return is_owed

    def _publish(self, names: list[str]) -> None:
        joined = self._join()
        for name in names:  # at once: in some milliseconds the participant will be known, and heard by everybody
            message_class, message = self._kept[name]
            try:
                publisher = joined[1].create_publisher(message_class, name, make_profile(MIRROR))
                for _ in range(_MORE_PARTICIPANTS):
                    if not joined[1].count_subscribers(name):
                        break
                    joined[1].destroy_publisher(publisher)
                    joined = self._join_instead_of(joined)
                    publisher = joined[1].create_publisher(message_class, name, make_profile(MIRROR))
                else:
                    _log.warning("a kept value may be heard twice: each new participant was known at once", topic=name)
                publisher.publish(message)
                self._published[name] = joined[1], publisher
            except Exception:  # noqa: BLE001 - rclpy raises what it likes; one topic, one mistake
                _log.exception("a kept value could not be published for late subscribers", topic=name)
            del self._kept[name]

    def _join(self) -> tuple[Any, Any]:
        joined = make_node(self._config.space, f"{self._config.node_name}_late", self._config.discovery)
        self._participants.append(joined)
        return joined

    def _join_instead_of(self, known: tuple[Any, Any]) -> tuple[Any, Any]:
        """A new participant; the one that is known already ends, unless it has published another value."""
        joined = self._join()
        if all(node is not known[1] for node, _ in self._published.values()):
            self._participants.remove(known)
            leave(*known)
        return joined

    def close(self) -> None:
        """Leave the domain."""
        self._kept.clear()
        self._published.clear()
        for context, node in self._participants:
            leave(context, node)
        self._participants.clear()
