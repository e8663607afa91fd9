# pyright: basic, reportMissingImports=false
"""One topic of the ROS 1 graph that the bridge listens to, whatever its message type."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple
from weakref import WeakSet

import genpy
import rospy

from ua_bridges.ros.errors import ConversionError
from ua_bridges.ros1.classes import type_of_publisher
from ua_bridges.ros1.feed import Feed, Read
from ua_bridges.ros1.graph import LinkRetry
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.node import RosNode
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.counters import Drop
from ua_fleet.errors import UaFleetError

__all__ = ["RosSource"]

LOST_AFTER_LOOKS: Final = 2
"""A last message may still be on its way through a callback when its link is found closed."""
SUBSCRIBER_BUFFER_BYTES: Final = 1 << 20
"""What one read takes from a link; rospy's 64 KiB make an image many reads."""

_NOTHING: Final = Dropped(Drop.CONVERSION, 0)


class _Reading(NamedTuple):
    """How messages of one type are read."""

    key: tuple[str, str]
    cls: type[Any]
    reads: tuple[Read, ...]


class _Link(NamedTuple):
    """A publisher's link: its connection header, and what becomes of its messages."""

    header: dict[str, str]
    own: bool
    reading: _Reading | None
    endpoint: str | None
    """Of a latched publisher, the address of its process: its first message may be one that was heard before."""
    refusal: Dropped
    """Why its messages are dropped, where `reading` is None."""


class RosSource:
    """A subscription to one topic. It is alive while a TCPROS link to another node's publisher is up.

    `_on_message` runs in rospy's thread of the link, everything else in the bridge's watch.
    """

    def __init__(self, name: str, feeds: Sequence[Feed], node: RosNode, inlet: Inlet, memory: LatchMemory) -> None:
        self.name = name
        self._memory = memory
        self._is_first = True
        self._feeds = feeds
        self._topic = next((feed.topic for feed in feeds if feed.topic is not None), None)
        """Of the DataSet by which a latched message is remembered."""
        self._node = node
        self._inlet = inlet
        self._retry = LinkRetry()
        self._lock = threading.Lock()
        self._links: dict[int, _Link] = {}
        self._last: _Link | None = None
        self._watched: WeakSet[Any] = WeakSet()
        """Sockets whose other end the kernel looks after."""
        self._current: _Reading | None = None
        """The reading under which the source was announced; None while it is lost."""
        self._missing = 0
        self._told: set[str] = set()
        self._subscriber = rospy.Subscriber(
            name, rospy.AnyMsg, self._on_message, buff_size=SUBSCRIBER_BUFFER_BYTES, tcp_nodelay=True
        )

    def _on_message(self, raw: Any) -> None:
        received_ns = time.time_ns()
        header = raw._connection_header  # noqa: SLF001 - the documented way to it
        link = self._last
        if link is None or link.header is not header:
            link = self._link_of(header)
        reading = link.reading
        if reading is None:
            self._inlet.put(link.refusal)
            return
        try:
            content = raw._buff  # noqa: SLF001 - rospy's name for it
            message = reading.cls().deserialize(content)
            if link.endpoint is not None and self._topic is not None:
                received_ns = self._memory.time_of(
                    self._topic, content, link.endpoint, received_ns, first=self._is_first
                )
            if not link.own:
                self._is_first = False
            for read in reading.reads:
                read(message, received_ns, link.own)
        except (genpy.DeserializationError, ConversionError, UnicodeDecodeError) as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=self._tell_once(f"{self.name}: {error}")))

    def _tell_once(self, text: str) -> str:
        """The text the first time, then nothing: one message's reason is a robot's reason for hours."""
        if text in self._told or len(self._told) > 20:
            return ""
        self._told.add(text)
        return text

    def _link_of(self, header: dict[str, str]) -> _Link:
        """The link with this header; a new one announces the source if it is the first."""
        with self._lock:
            link = self._links.get(id(header))
            if link is None:
                link = self._links[id(header)] = self._make_link(header)
            self._last = link
            return link

    def _make_link(self, header: dict[str, str]) -> _Link:
        own = header.get("callerid") == self._node.name
        key = (header["type"], header["md5sum"])
        reading = self._current
        if reading is None or reading.key != key:
            if any(link.reading is reading and not link.own for link in self._links.values() if reading):
                text = (
                    f"{self.name}: publishers disagree about the type; {key[0]} of {header.get('callerid')} is not read"
                )
                return _Link(header, own, None, None, Dropped(Drop.CONFLICT, detail=text))
            try:
                kind = type_of_publisher(*key, header.get("message_definition", ""))
                reading = _Reading(key, kind.cls, tuple(feed.reader(kind) for feed in self._feeds))
                if not own:
                    for feed in self._feeds:
                        feed.announce(kind, header.get("latching") == "1")
            except UaFleetError as error:
                return _Link(header, own, None, None, Dropped(Drop.TYPE_MISSING, detail=f"{self.name}: {error}"))
            if not own:
                self._current = reading
                self._missing = 0
        endpoint = self._endpoint(header) if header.get("latching") == "1" and not own else None
        return _Link(header, own, reading, endpoint, _NOTHING)

    def _endpoint(self, header: dict[str, str]) -> str:
        addresses = (str(link.endpoint_id) for link in self._node.links(self.name) if link.header is header)
        return next(addresses, "")

    def check(self, publishers: Iterable[str] | None, now: float) -> bool:
        """Look at the links; whether the master should be asked again for the publishers' addresses.

        Args:
            publishers: the nodes that the master has as publishers; None when the master is not there.
            now: seconds of a monotonic clock.
        """
        links = self._node.links(self.name)
        headers = {id(link.header): link.header for link in links}
        with self._lock:
            for gone in [key for key in self._links if key not in headers]:
                del self._links[gone]
            if self._last is not None and id(self._last.header) not in self._links:
                self._last = None
        for link in links:
            opened = link.socket  # None where rospy has closed it just now
            if opened is not None and opened not in self._watched:  # also where a message came before this look
                self._node.watch_link(link)
                self._watched.add(opened)
            if id(link.header) not in self._links:
                self._link_of(link.header)
        with self._lock:
            self._look_for_loss()
        return publishers is not None and self._retry.due(publishers, len(links), now)

    def _look_for_loss(self) -> None:
        if self._current is None or any(
            link.reading is self._current and not link.own for link in self._links.values()
        ):
            self._missing = 0
            return
        self._missing += 1
        if self._missing >= LOST_AFTER_LOOKS:
            self._lose()

    def _lose(self) -> None:
        self._current = None
        self._links.clear()  # a link of another type may take over: it is looked at anew
        self._last = None
        self._told.clear()
        for feed in self._feeds:
            feed.lost()
        if self._topic is not None:
            self._memory.forget(self._topic)

    def lose(self) -> None:
        """Say that the source is lost, since the node itself is going."""
        with self._lock:
            if self._current is not None:
                self._lose()
