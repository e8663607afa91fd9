# pyright: basic, reportMissingImports=false
"""The links from the topics that the bridge publishes to their subscribers: who has one, and whether it answers.

A rospy subscriber makes its link once. Where the link ends by an error it forgets it, and makes another only when the
master tells it of the topic's publishers again. Where the link ends at the bridge's side alone, since the network was
away meanwhile, it notices nothing for 60 s. So the bridge keeps a link as long as rospy does, looks for itself whether
its other end answers, and registers a topic again while a subscriber that the master names has no link.
"""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple

import rospy.impl.registration
import structlog

from ua_bridges.ros1.graph import LinkRetry
from ua_bridges.ros1.tcpros import has_undelivered, is_there, unanswered_s
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.counters import Drop
from ua_fleet.printing import harmless

__all__ = ["Relinking", "SubscriberLink", "links_of"]

LONGEST_S: Final = 10.0
"""Between two registrations of a topic for the same subscribers: rospy may ignore the first ones for 60 s."""
MOST_ASKED: Final = 32
"""Nodes that are asked at the same time whether they are there, a thread each."""

_LINGER_NOT: Final = struct.pack("ii", 1, 0)
_log = structlog.get_logger("ua_bridges.ros1")


class SubscriberLink(NamedTuple):
    """A link that a subscriber has made."""

    subscriber: str
    """Name of its node."""
    connection: Any
    """rospy's."""

    @property
    def unanswered_s(self) -> float:
        """See `tcpros.unanswered_s`."""
        link = self.connection.socket
        return float("inf") if link is None else unanswered_s(link)

    @property
    def has_undelivered(self) -> bool:
        """Whether messages were sent that the subscriber's host has not acknowledged."""
        link = self.connection.socket
        return link is not None and has_undelivered(link)

    def cut(self) -> None:
        """End the link; what is on its way is not delivered later."""
        link: socket.socket | None = self.connection.socket
        try:
            if link is not None:
                link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER_NOT)
        except OSError:
            pass  # it has ended by itself
        self.connection.close()


def links_of(topic: str) -> list[SubscriberLink]:
    """The links of a topic that this process publishes; callable from any thread."""
    publisher = rospy.impl.registration.get_topic_manager().get_publisher_impl(topic)
    if publisher is None:
        return []
    return [SubscriberLink(connection.endpoint_id, connection) for connection in publisher.connections]


class Relinking:
    """Says which topics to register again. All methods run in the thread of the watch, but what it begins itself.

    To register again has the master call every subscriber of the topic, which takes it minutes where a host is gone.
    So it is done only for subscribers that answer.
    """

    def __init__(
        self,
        node_name: str,
        inlet: Inlet,
        is_refused: Callable[[str, str], bool],
        wake: Callable[[], object],
    ) -> None:
        """Begin with all links as they should be.

        Args:
            node_name: of this process.
            inlet: where subscribers without a link are counted.
            is_refused: whether a subscriber of a topic has been refused its link, by topic and node.
            wake: has the watch look at once.
        """
        self._node_name, self._inlet, self._is_refused, self._wake = node_name, inlet, is_refused, wake
        self._retries: dict[str, LinkRetry] = {}
        """Of the topics with a subscriber that has no link."""
        self._relinked: dict[str, frozenset[str]] = {}
        """For whom a topic was registered again, until they have their links."""
        self._lock = threading.Lock()
        self._asked: set[str] = set()
        """Nodes that are being asked whether they are there."""
        self._answered: dict[str, set[str]] = {}
        """The topics to register again, with the nodes for which that is done."""

    def look(
        self,
        topics: Iterable[str],
        subscribers: Mapping[str, list[str]],
        uri_of: Callable[[str], str | None],
        now: float,
    ) -> None:
        """Look which subscribers have no link, and ask those that are due whether they are there.

        Args:
            topics: all that this process publishes and has registered.
            subscribers: of each topic, the nodes that the master names.
            uri_of: the address of a node, as the master tells it; may raise.
            now: seconds of a monotonic clock.
        """
        due: dict[str, set[str]] = {}
        missing_of: dict[str, frozenset[str]] = {}
        for topic in topics:
            if missing := self._missing(topic, subscribers.get(topic, ())):
                missing_of[topic] = missing
                if self._retries.setdefault(topic, LinkRetry(longest_s=LONGEST_S)).due(missing, 0, now):
                    for node in missing:
                        due.setdefault(node, set()).add(topic)
        self._retries = {topic: retry for topic, retry in self._retries.items() if topic in missing_of}
        for topic, nodes in list(self._relinked.items()):
            if not nodes & missing_of.get(topic, frozenset()):
                del self._relinked[topic]
                if nodes & frozenset(subscribers.get(topic, ())):
                    _log.info("a subscriber is linked again", topic=topic, node=_text(nodes))
        for node, unlinked in due.items():
            uri = uri_of(node)
            if uri is not None:
                self._ask(node, uri, unlinked)

    def _missing(self, topic: str, subscribers: Iterable[str]) -> frozenset[str]:
        wanted = {name for name in subscribers if name != self._node_name and not self._is_refused(topic, name)}
        return frozenset(wanted.difference(link.subscriber for link in links_of(topic)) if wanted else ())

    def _ask(self, node: str, uri: str, topics: set[str]) -> None:
        with self._lock:
            if node in self._asked or len(self._asked) >= MOST_ASKED:
                return
            self._asked.add(node)
        threading.Thread(target=self._wait, args=(node, uri, topics), name="ros1-relink", daemon=True).start()

    def _wait(self, node: str, uri: str, topics: set[str]) -> None:
        is_here = is_there(uri, self._node_name)
        with self._lock:
            self._asked.discard(node)
            if is_here:
                for topic in topics:
                    self._answered.setdefault(topic, set()).add(node)
        if is_here:
            self._wake()

    def take_due(self) -> list[str]:
        """The topics to register again now. Each is counted, and told once."""
        with self._lock:
            answered, self._answered = self._answered, {}
        for topic, nodes in answered.items():
            before = self._relinked.get(topic, frozenset())
            self._relinked[topic] = before | nodes
            self._inlet.put(Dropped(Drop.UNLINKED))
            if nodes - before:
                _log.warning("a subscriber has no link; its topic is registered again", topic=topic, node=_text(nodes))
        return list(answered)


def _text(nodes: Iterable[str]) -> str:
    return harmless(", ".join(sorted(nodes)))[:200]
