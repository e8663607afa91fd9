# pyright: basic, reportMissingImports=false
"""One topic of the ROS 1 graph that the bridge listens to, whatever its message type."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Final, NamedTuple

import genpy

from ua_bridges.ros.errors import ConversionError, Unreadable
from ua_bridges.ros.feed import Feed, Read
from ua_bridges.ros.schema import ros1_type_name
from ua_bridges.ros.serialized import flat_reader, stamp_reader
from ua_bridges.ros.stamp import source_time_ns
from ua_bridges.ros1.classes import type_of_publisher
from ua_bridges.ros1.graph import LinkRetry
from ua_bridges.ros1.layout import Layout, TooMany
from ua_bridges.ros1.link import Link
from ua_bridges.ros1.memory import LatchMemory
from ua_bridges.ros1.tcpros import Broken
from ua_fleet.bridge.driver import Dropped, Inlet
from ua_fleet.bridge.offenders import Offenders
from ua_fleet.counters import Drop
from ua_fleet.errors import UaFleetError

__all__ = ["MakeLink", "RosSource"]

LOST_AFTER_LOOKS: Final = 2
"""A last message may still be on its way through a callback when its link is found closed."""
MOST_LINKS: Final = 64
"""Publishers of one topic that are linked to; anybody may register more."""
SILENT_S: Final = 10.0
"""A link that has brought nothing for so long gives way to a publisher that there is no place for."""
MOST_BAD: Final = 10
"""So many messages in a row that cannot be read, and their publisher is put aside."""
MOST_CHANGES: Final = 8
CHANGES_WITHIN_S: Final = 60.0
"""More changes of a topic's type within that time, and the publisher that changed it is put aside."""

_NOTHING: Final = Dropped(Drop.CONVERSION, 0)

MakeLink = Callable[[str, str, str, "RosSource"], Link]


class _Reading(NamedTuple):
    """How messages of one type are read."""

    key: tuple[str, str]
    layout: Layout
    reads: tuple[Read, ...]
    stamp: Callable[[bytes], int] | None
    """Reads the robot's own time; None where the messages have none, or nobody needs it."""


class _Taken:
    """What becomes of a link's messages."""

    __slots__ = ("bad", "endpoint", "heard_at", "is_rival", "own", "reading", "refusal")

    def __init__(
        self,
        reading: _Reading | None,
        refusal: Dropped,
        *,
        own: bool,
        endpoint: str | None = None,
        is_rival: bool = False,
    ) -> None:
        self.own, self.reading = own, reading
        self.is_rival = is_rival
        """Whether its messages are dropped since another publisher of the topic has another type."""
        self.endpoint = endpoint
        """Of a latched publisher, the address of its process: its first message may be one that was heard before."""
        self.refusal = refusal
        """Why its messages are dropped, where `reading` is None."""
        self.bad = 0
        """Messages in a row that could not be read."""
        self.heard_at: float | None = None
        """When the last message came that could be read; None: none has come."""


class RosSource:
    """A topic with the links to its publishers. It is alive while a link to another node's publisher is up.

    `link_up`, `link_heard` and `link_ended` run in the threads of the links, everything else in the bridge's watch.
    """

    def __init__(
        self,
        name: str,
        feeds: Sequence[Feed],
        node_name: str,
        inlet: Inlet,
        memory: LatchMemory,
        offenders: Offenders,
        make_link: MakeLink = Link,
    ) -> None:
        """Listen to a topic, once `connect` tells its publishers.

        Args:
            name: full name of the topic.
            feeds: who reads it.
            node_name: of this process.
            inlet: where drops are told.
            memory: of latched sources.
            offenders: the publishers that are put aside.
            make_link: makes a link to a publisher.
        """
        self.name = name
        self._memory = memory
        self._is_first = True
        self._feeds = feeds
        self._topic = next((feed.topic for feed in feeds if feed.topic is not None), None)
        """Of the DataSet by which a latched message is remembered."""
        self._wanted = frozenset(ros1_type_name(feed.wanted_type) for feed in feeds if feed.wanted_type is not None)
        """The types that `fleet.yaml` gives the topic; empty where it is its publishers' to say."""
        self._node_name, self._inlet, self._offenders, self._make_link = node_name, inlet, offenders, make_link
        self._retry = LinkRetry()
        self._lock = threading.Lock()
        self._links: dict[str, Link] = {}
        """By the address of the publisher's node; those too that are being made."""
        self._made: dict[str, float] = {}
        """When each of them was begun."""
        self._taken: dict[Link, _Taken] = {}
        """The links that are up."""
        self._current: _Reading | None = None
        """The reading under which the source was announced; None while it is lost."""
        self._changes: deque[float] = deque(maxlen=MOST_CHANGES)
        """When it was announced with another type than before."""
        self._last_key: tuple[str, str] | None = None
        self._missing = 0
        self._is_closed = False
        self._told: set[str] = set()

    @property
    def is_alive(self) -> bool:
        """Whether it was announced and is not lost."""
        return self._current is not None

    def connect(self, uris: Iterable[str], now: float) -> None:
        """Link to the publishers that there is no link to yet, and that are not put aside; returns at once."""
        for uri in uris:
            with self._lock:
                if self._is_closed or uri in self._links or self._offenders.is_aside(self._offender(uri), now):
                    continue
                if len(self._links) >= MOST_LINKS and not self._make_room(now):
                    continue
                link = self._links[uri] = self._make_link(self.name, uri, self._node_name, self)
                self._made[uri] = now
            link.start()

    def _make_room(self, now: float) -> bool:
        """Have the link give way that has been silent for longest, those first that never brought a message."""

        def heard(uri: str) -> tuple[bool, float]:
            taken = self._taken.get(self._links[uri])
            heard_at = None if taken is None else taken.heard_at
            return (False, self._made[uri]) if heard_at is None else (True, heard_at)

        for uri in sorted(self._links, key=heard):
            if now >= heard(uri)[1] + SILENT_S:
                self._end(uri).close()
                text = self._tell_once(f"{self.name}: more than {MOST_LINKS} publishers; silent ones give way")
                self._inlet.put(Dropped(Drop.UNKNOWN_SOURCE, detail=text))
                return True
        return False

    def _end(self, uri: str) -> Link:
        """Take a link out."""
        link = self._links.pop(uri)
        del self._made[uri]
        self._taken.pop(link, None)
        return link

    def _offender(self, uri: str) -> str:
        return f"{self.name} of {uri}"

    def link_up(self, link: Link) -> None:
        """See LinkOwner: a link announces the source if it is the first."""
        header = link.header
        with contextlib.suppress(UaFleetError):  # said below; a new type takes time, for which the watch must not wait
            type_of_publisher(header["type"], header["md5sum"], header.get("message_definition", ""))
        with self._lock:
            if self._links.get(link.uri) is link:
                self._taken[link] = self._take(link)

    def link_heard(self, link: Link, content: bytes) -> None:
        """See LinkOwner."""
        received_ns = time.time_ns()
        taken = self._taken.get(link)
        if taken is None or taken.is_rival:
            with self._lock:
                if self._links.get(link.uri) is not link:
                    return
                taken = self._taken[link] = self._take(link, content)
        reading = taken.reading
        if reading is None:
            self._inlet.put(taken.refusal)
            return
        try:
            self._read(taken, reading, content, received_ns)
        except (TooMany, ConversionError, genpy.DeserializationError, UnicodeDecodeError) as error:
            self._inlet.put(Dropped(Drop.CONVERSION, detail=self._tell_once(f"{self.name}: {error}")))
            if isinstance(error, ConversionError) and not isinstance(error, Unreadable):
                return  # a message, with a value that has no place on the other side
            taken.bad += 1
            if taken.bad >= MOST_BAD:
                raise Broken(f"{MOST_BAD} messages in a row are no {reading.key[0]}, the last: {error}") from error
        else:
            taken.bad, taken.heard_at = 0, time.monotonic()

    def _read(self, taken: _Taken, reading: _Reading, content: bytes, received_ns: int) -> None:
        reading.layout.check(content)
        if taken.endpoint is not None and self._topic is not None:
            received_ns = self._memory.time_of(self._topic, content, taken.endpoint, received_ns, first=self._is_first)
        if not taken.own:
            self._is_first = False
        time_ns = received_ns if reading.stamp is None else source_time_ns(reading.stamp(content), received_ns)
        for read in reading.reads:
            read(content, time_ns, taken.own)

    def link_ended(self, link: Link, offence: str | None) -> None:
        """See LinkOwner."""
        with self._lock:
            self._taken.pop(link, None)
            if self._links.get(link.uri) is link:
                self._end(link.uri)
        if offence is not None:
            self._offenders.put_aside(self._offender(link.uri), offence, time.monotonic())

    def _tell_once(self, text: str) -> str:
        """The text the first time, then nothing: one message's reason is a robot's reason for hours."""
        if text in self._told or len(self._told) > 20:
            return ""
        self._told.add(text)
        return text

    def _take(self, link: Link, content: bytes | None = None) -> _Taken:
        """How a link's messages are read; `content` is its first one, if it has come."""
        header = link.header
        own = header.get("callerid") == self._node_name
        key = (header["type"], header["md5sum"])
        reading = self._current
        if reading is None or reading.key != key:
            others = [
                other for other, taken in self._taken.items() if reading and taken.reading is reading and not taken.own
            ]
            why = ""
            if reading is not None and others:
                why = "" if own else self._why_to_give_way(reading, others, link, content)
                if not why:
                    name = header.get("callerid")
                    text = f"{self.name}: publishers disagree about the type; {key[0]} of {name} is not read"
                    return _Taken(None, Dropped(Drop.CONFLICT, detail=text), own=own, is_rival=True)
            if not own:
                self._count_change(key)
            try:
                kind = type_of_publisher(*key, header.get("message_definition", ""))
                reads = tuple(feed.reader(kind) for feed in self._feeds)
                reading = _Reading(key, kind.layout, reads, None if self._topic is None else stamp_reader(kind))
                if not own:
                    for feed in self._feeds:
                        feed.announce(kind, header.get("latching") == "1")
            except UaFleetError as error:
                return _Taken(None, Dropped(Drop.TYPE_MISSING, detail=f"{self.name}: {error}"), own=own)
            if not own:
                self._current = reading
                self._missing = 0
                for other in others:
                    self._refuse(other, why, time.monotonic())
        endpoint = link.uri if header.get("latching") == "1" and not own else None
        return _Taken(reading, _NOTHING, own=own, endpoint=endpoint)

    def _why_to_give_way(self, reading: _Reading, others: Iterable[Link], link: Link, content: bytes | None) -> str:
        """Why publishers of another type have to give way to the one of a link; empty where they have not.

        `fleet.yaml` decides, where it gives the topic a type; else the first that says something. Raises Broken where
        that is no message.
        """
        now_type, new_type = reading.key[0], link.header["type"]
        if new_type in self._wanted and now_type not in self._wanted:
            return f"its type is {now_type}; another publisher has {new_type}, as fleet.yaml says"
        if now_type in self._wanted or content is None:
            return ""
        if any(self._taken[other].heard_at is not None for other in others):
            return ""
        header = link.header
        try:
            kind = type_of_publisher(new_type, header["md5sum"], header.get("message_definition", ""))
        except UaFleetError:
            return ""
        try:
            kind.layout.check(content)
            flat_reader(kind)(content)
        except (TooMany, Unreadable, genpy.DeserializationError, UnicodeDecodeError) as error:
            raise Broken(f"its first message is no {new_type}: {error}") from error
        except ConversionError:
            pass  # a message, with a value that has no place on the other side
        return f"it says nothing, and its type is {now_type}; another publisher says something, as {new_type}"

    def _count_change(self, key: tuple[str, str]) -> None:
        """Each type that nobody has installed costs a class: who changes it all the time is put aside."""
        before, self._last_key = self._last_key, key
        if before is None or before == key:
            return
        now = time.monotonic()
        if len(self._changes) == MOST_CHANGES and now < self._changes[0] + CHANGES_WITHIN_S:
            self._last_key = before
            raise Broken(f"it has changed the type of its topic {MOST_CHANGES} times within {CHANGES_WITHIN_S:g} s")
        self._changes.append(now)

    def check(self, publishers: Iterable[str] | None, now: float) -> bool:
        """Look at the links; whether the master should be asked again for the publishers' addresses.

        Args:
            publishers: the nodes that the master has as publishers; None when the master is not there.
            now: seconds of a monotonic clock.
        """
        with self._lock:
            for link in [each for each in self._links.values() if each.header and each not in self._taken]:
                try:
                    self._taken[link] = self._take(link)
                except Broken as error:
                    self._refuse(link, str(error), now)
            self._look_for_loss()
            links = len(self._links)
        return publishers is not None and self._retry.due(publishers, links, now)

    def _refuse(self, link: Link, offence: str, now: float) -> None:
        self._end(link.uri).close()
        self._offenders.put_aside(self._offender(link.uri), offence, now)

    @property
    def is_missed(self) -> bool:
        """Whether its links were gone at the last look, and it is not lost yet."""
        return self._missing > 0 and self._current is not None

    def _look_for_loss(self) -> None:
        if self._current is None or any(
            taken.reading is self._current and not taken.own for taken in self._taken.values()
        ):
            self._missing = 0
            return
        self._missing += 1
        if self._missing >= LOST_AFTER_LOOKS:
            self._lose()

    def _lose(self) -> None:
        self._current = None
        self._taken.clear()  # a link of another type may take over: it is looked at anew
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

    def close(self) -> list[Link]:
        """End all links; those that are ending. Nothing is told any more."""
        with self._lock:
            self._is_closed = True
            links = list(self._links.values())
            self._links.clear()
            self._made.clear()
            self._taken.clear()
        for link in links:
            link.close()
        return links

    def open_again(self) -> None:
        """Listen again after `close`."""
        with self._lock:
            self._is_closed = False
