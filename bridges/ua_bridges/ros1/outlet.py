# pyright: basic, reportMissingImports=false
"""A topic that the bridge publishes into the ROS 1 graph."""

from __future__ import annotations

import copy
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from struct import Struct
from typing import Any, Final

import genpy
import rospy

from ua_bridges.ros.codec import compile_encoder
from ua_bridges.ros.convert import compile_writer
from ua_bridges.ros.outlets import Gone
from ua_bridges.ros1.classes import MessageType

__all__ = ["QUEUE_SIZE", "Outlet"]

_SEQ: Final = Struct("<I")

QUEUE_SIZE: Final = 100
"""Messages that wait for a slow subscriber; then its oldest go. A thread of the link sends them, not the event loop."""
HOLD_S: Final = 1.0
"""So long the first messages wait for the subscribers that are there; connecting takes them some 10 ms."""
LATCH_S: Final = 5.0
"""The same where there is but a message that the bridge before this one had published, which rospy gives to whoever
connects from then on: on a busy machine robots that have it already needed more than a second."""


class _Header:
    """What rospy numbers in a message with a Header at its begin."""

    __slots__ = ("seq",)
    frame_id = ""

    def __init__(self) -> None:
        self.seq = 0


def _serialized_class(kind: MessageType) -> type[Any]:
    """A class of messages that are serialized already, which rospy publishes as those of the type."""
    has_header = bool(kind.cls._has_header)  # noqa: SLF001 - genpy's name for it

    class Serialized(genpy.Message):  # type: ignore[misc]  # genpy has no types
        _type, _md5sum, _full_text, _has_header = kind.name, kind.md5sum, kind.definition, has_header
        __slots__ = ("content", "header")

        def __init__(self, content: bytes = b"") -> None:
            self.content, self.header = content, _Header()

        def serialize(self, buff: Any) -> None:
            if has_header:
                buff.write(_SEQ.pack(self.header.seq))
                buff.write(memoryview(self.content)[_SEQ.size :])
            else:
                buff.write(self.content)

    return Serialized


class Outlet:
    """See `ua_bridges.ros.outlets.Outlet`. All methods but `is_ready` run in the event loop."""

    def __init__(
        self,
        name: str,
        kind: MessageType,
        fields: Sequence[str],
        *,
        latched: bool,
        shared: Any | None = None,
        queue_size: int = QUEUE_SIZE,
    ) -> None:
        """Make the publisher; the watch registers it with the master.

        Args:
            name: the topic with its slash.
            kind: type of the messages.
            fields: the flat field of each value that `publish` gets.
            latched: whether late subscribers get the last message.
            shared: a message in which `fields` are set and all others stay, for DataSets that share a topic.
            queue_size: messages that wait for a slow subscriber.

        Raises:
            ConversionError: the fields are not those of the type.
        """
        self.name = name
        self.kind = kind
        self._fill = compile_writer(kind.schema, tuple(fields), kind.make, partial=shared is not None)
        self._shared = shared
        self._make = kind.cls
        explain = partial(self._fill, kind.cls())
        self._encode = compile_encoder(kind.schema, tuple(fields), explain) if shared is None else None
        published = kind.cls
        if self._encode is not None:
            published = self._make = _serialized_class(kind)
        self._publisher = rospy.Publisher(name, published, queue_size=queue_size, latch=latched, tcp_nodelay=True)
        self._held: deque[tuple[Any, Gone]] | None = deque()
        self._remembered: Any = None
        self._owed: frozenset[str] = frozenset()
        self.is_latched = latched
        self._made = time.monotonic()

    @property
    def is_open(self) -> bool:
        """Whether messages go out at once."""
        return self._held is None

    def is_ready(self, subscribers: int | None) -> bool:
        """Whether it should be opened: so many subscribers are there (None: unknown), and they have their links.

        Callable from any thread.
        """
        hold_s = LATCH_S if self._remembered is not None and not self._held else HOLD_S
        if time.monotonic() > self._made + hold_s:
            return True
        return subscribers is not None and int(self._publisher.get_num_connections()) >= subscribers

    def publish(self, values: Sequence[Any], gone: Gone) -> int:
        """Publish one message, or hold it until the subscribers are there; raises ConversionError.

        Returns how many held messages, the oldest, went for it. `gone` is called when it is published.
        """
        message = self._message(values)
        if self._held is None:
            self._publisher.publish(message)
            gone()
            return 0
        self._held.append((message, gone))
        if len(self._held) <= QUEUE_SIZE:
            return 0
        self._held.popleft()
        return 1

    def write(self, values: Sequence[Any]) -> bool:
        """Publish one message now, or not at all, since it would be worthless later; whether it went out.

        Raises ConversionError.
        """
        if self._held is None:
            self._publisher.publish(self._message(values))
        return self._held is None

    @property
    def listeners(self) -> int:
        """How many subscribers have a link."""
        return int(self._publisher.get_num_connections()) if self._held is None else 0

    def _message(self, values: Sequence[Any]) -> Any:
        if self._encode is not None:
            return self._make(self._encode(values))
        if self._shared is None:
            message = self._make()
            self._fill(message, values)
            return message
        self._fill(self._shared, values)
        return copy.deepcopy(self._shared)

    def remember(self, values: Sequence[Any]) -> None:
        """Keep a message that the bridge before this one has published; if latched, those get it that it is owed to."""
        self._remembered = self._message(values)
        if self._held is None:
            self._latch()

    def supersede(self) -> None:
        """See Outlet: what is published takes the place of what was kept."""

    def _latch(self) -> None:
        implementation: Any = self._publisher.impl
        if self._remembered is None or implementation is None or not self.is_latched:
            return
        with implementation.publock:
            implementation.latch = self._remembered  # rospy sends it on each new link
            for link in implementation.connections:
                if link.endpoint_id in self._owed:
                    implementation.publish(self._remembered, connection_override=link)

    def open(self, owed: frozenset[str] = frozenset()) -> None:
        """Send what was held; from now on messages go out at once.

        `owed` are the subscribers which the bridge before this one had not served, by their names.
        """
        self._owed = owed
        self._latch()
        held, self._held = self._held, None
        for message, gone in held or ():
            self._publisher.publish(message)
            gone()

    def close(self) -> int:
        """End the publisher; how many messages it held that go with it."""
        self._publisher.unregister()
        return len(self._held or ())
