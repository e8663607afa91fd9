# pyright: basic, reportMissingImports=false
"""What a skill hears on a topic, handed over from the thread of a link to the skills' thread."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any, Final

from ua_bridges.ros.feed import Read
from ua_bridges.ros.ports import Listened
from ua_bridges.ros.serialized import MessageKind
from ua_bridges.ros1.skills.graph import ros1_name
from ua_fleet.bridge.driver import DriverEvent, Dropped
from ua_fleet.counters import Drop

__all__ = ["SkillFeed"]

MOST_WAITING: Final = 1000
"""Messages of one topic that wait for the skills' thread; then the oldest goes, as in the subscription of ROS 2."""
MOST_WAITING_BYTES: Final = 16 << 20
"""And so many bytes, as they came; one message may have more."""


class SkillFeed:
    """See `ua_bridges.ros.feed.Feed`. A topic that floods pushes out its own messages alone."""

    topic = None

    def __init__(
        self, listened: Listened, call: Callable[[Callable[[], None]], None], put: Callable[[DriverEvent], None]
    ) -> None:
        """Hear nothing yet.

        Args:
            listened: the topic, and who hears it.
            call: has a step done in the skills' thread.
            put: where drops are told.
        """
        self._listened, self._call, self._put, self.wanted_type = listened, call, put, ros1_name(listened.type)
        self._lock = threading.Lock()
        self._waiting: deque[tuple[int, Any]] = deque()
        """Each message with its size."""
        self._bytes = 0
        self._steps = 0
        """That are to be done in the skills' thread: one for each message that waits, or more."""

    def announce(self, kind: MessageKind, latched: bool) -> None:
        """See Feed."""
        if kind.name == self.wanted_type:
            self._call(partial(self._listened.source, ""))
        else:
            self.mistyped(kind.name, 0)

    def reader(self, kind: MessageKind) -> Read:
        """See Feed."""
        is_wanted, message = kind.name == self.wanted_type, kind.message_reader()

        def read(content: bytes, time_ns: int, own: bool) -> None:
            if is_wanted and not own:
                self._keep(len(content), message(content))

        return read

    def mistyped(self, ros_type: str, time_ns: int) -> None:
        """See Feed."""
        said = f"{self._listened.name} carries {ros_type}, and not {self.wanted_type}; correct `type`"
        self._call(partial(self._listened.source, said))

    def lost(self) -> None:
        """See Feed."""
        self._call(partial(self._listened.source, f"{self._listened.name} has no publisher; start the robot's node"))

    def _keep(self, size: int, message: Any) -> None:
        lost = 0
        with self._lock:
            self._waiting.append((size, message))
            self._bytes += size
            while len(self._waiting) > MOST_WAITING or (self._bytes > MOST_WAITING_BYTES and len(self._waiting) > 1):
                self._bytes -= self._waiting.popleft()[0]
                lost += 1
            needs_step = self._steps < len(self._waiting)
            self._steps += needs_step
        if lost:
            said = f"{self._listened.name}: more messages than the skill that hears it can look at"
            self._put(Dropped(Drop.INLET_FULL, lost, said))
        if needs_step:
            self._call(self._hear)

    def _hear(self) -> None:
        with self._lock:
            self._steps -= 1
            if not self._waiting:
                return
            size, message = self._waiting.popleft()
            self._bytes -= size
        self._listened.heard(message)
