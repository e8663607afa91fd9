# pyright: basic, reportMissingImports=false
"""A topic that the bridge publishes into the ROS 2 graph."""

from __future__ import annotations

import copy
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final

from ua_bridges.ros.convert import Writer
from ua_bridges.ros.outlets import Gone
from ua_bridges.ros2.classes import MessageType
from ua_bridges.ros2.node import Ros2Node
from ua_bridges.ros2.qos import Offer, Qos

__all__ = ["HeldPublisher", "Make"]

Make = Callable[[Sequence[Any]], Any]
"""Makes a message of values, an object or its serialized bytes; raises ConversionError."""

MOST_HELD: Final = 1000
_HOLD_S: Final = 1.0
"""So long the first messages wait for subscribers that are known; they match within some 10 ms."""
_UNRELIABLE_MATCH_S: Final = 0.05
_SETTLE_S: Final = 1.0
"""A node that has just come up has not heard of all subscribers before: on a busy machine that took 0.7 s."""


class HeldPublisher:
    """The publisher of a topic, made while messages for it may come already.

    The node's thread makes it (`attend`), the event loop uses it (`publish`). Between the two the first messages are
    held: the subscribers that are there need some milliseconds to match, and what is published before is lost to them.
    A match on our side says nothing of theirs, and a publisher of depth 1 has only its last message to send again. So
    the first message goes alone, and the others when it is acknowledged.
    """

    def __init__(self, name: str, kind: MessageType, qos: Qos) -> None:
        self.name = name
        self.kind = kind
        self.qos = qos
        self._message = kind.cls()
        """The last message. DataSets that share a topic each set their fields in it, and leave those of the others."""
        self._publisher: Any = None
        self._is_open = False
        self._held: deque[tuple[Any, Gone]] = deque()
        self._lock = threading.Lock()
        self._hold_until = 0.0
        self._matched_at: float | None = None
        self._is_tried = False
        """Whether the first message is under way."""

    @property
    def is_open(self) -> bool:
        """Whether messages go out at once."""
        return self._is_open

    def filling(self, fill: Writer) -> Make:
        """Makes messages by putting values into the last one, which `fill` does."""

        def make(values: Sequence[Any]) -> Any:
            fill(self._message, values)
            return self._message

        return make

    def publish(self, make: Make, values: Sequence[Any], gone: Gone) -> int:
        """Publish one message, or hold it until the subscribers are there; raises ConversionError.

        Returns how many held messages, the oldest, went for it. `gone` is called in either thread.
        """
        message = make(values)
        lost = None if self._is_open else self._hold(message, gone)
        if lost is None:
            self._publisher.publish(message)  # rclpy serialises it before it returns
            gone()
        return lost or 0

    def write(self, make: Make, values: Sequence[Any]) -> bool:
        """Publish a message now, or not at all, since it would be worthless later; whether it went out.

        Raises ConversionError.
        """
        if self._is_open:
            self._publisher.publish(make(values))
        return self._is_open

    @property
    def listeners(self) -> int:
        """How many subscribers have matched."""
        return self._publisher.get_subscription_count() if self._is_open else 0

    def _hold(self, message: Any, gone: Gone) -> int | None:
        """Keep a copy of the message until the outlet is open, and how many went for it; None if it is open by now."""
        with self._lock:
            if self._is_open:
                return None
            self._held.append((copy.deepcopy(message), gone))
            if len(self._held) <= MOST_HELD:
                return 0
            self._held.popleft()
            return 1

    def attend(self, node: Ros2Node, now: float, opened_at: float, on_incompatible: Callable[[str], None]) -> bool:
        """Make the publisher, and open when the subscribers that are there have matched; whether that is done.

        Args:
            node: the node, in whose thread this is called.
            now: the monotonic time.
            opened_at: when the node came up.
            on_incompatible: told of subscribers that the publisher's quality of service does not suit.
        """
        if self._publisher is None:
            self._publisher = node.create_publisher(self.kind.cls, self.name, self.qos, on_incompatible)
            self._hold_until = max(now, opened_at + _SETTLE_S) + _HOLD_S
        if now >= self._hold_until:
            while not self._next():
                pass
            return True
        if now < opened_at + _SETTLE_S or not self._is_matched(node, now):
            return False
        if not self._publisher.wait_for_all_acked(node.no_time):
            return False
        if self._is_tried:
            while not self._next():
                pass
            return True
        self._is_tried = True
        return self._next()

    def _is_matched(self, node: Ros2Node, now: float) -> bool:
        """Whether the subscribers that are there hear us, as far as one can know."""
        if self._matched_at is None:
            there = [s.offer for s in node.subscribers(self.name) if not s.own and self._suits(s.type, s.offer)]
            if self._publisher.get_subscription_count() < len(there):
                return False
            unreliable = any(not offer.reliable for offer in there)  # they never tell what they have got
            self._matched_at = now + (_UNRELIABLE_MATCH_S if unreliable else 0.0)
        return now >= self._matched_at

    def _suits(self, ros_type: str, asked: Offer) -> bool:
        return (
            ros_type.replace("/msg/", "/") == self.kind.name
            and (self.qos.reliable or not asked.reliable)
            and (self.qos.transient_local or not asked.transient_local)
        )

    def _next(self) -> bool:
        """Publish the oldest message that is held; open when none is, and say so."""
        with self._lock:
            if not self._held:
                self._is_open = True
                return True
            message, gone = self._held.popleft()
        self._publisher.publish(message)
        gone()
        return False

    def close(self, node: Ros2Node) -> int:
        """End the publisher, in the node's thread; how many messages it held that go with it."""
        with self._lock:
            self._is_open, lost = False, len(self._held)
            self._held.clear()
        if self._publisher is not None:
            node.node.destroy_publisher(self._publisher)
            self._publisher = None
        return lost
