"""The last message of each latched source, kept for the bridge that is started after this one.

A latched publisher sends its last message to every new link, and ROS 1 messages carry no time. A bridge that comes up
would take it for a new one, and all other spaces would get it again.
"""

from __future__ import annotations

import hashlib
import threading
from pathlib import Path

from ua_bridges.ros.delivered import Delivered
from ua_fleet.topics import Topic

__all__ = ["LatchMemory"]


class LatchMemory:
    """When the last message of a latched source came, and what it was. Callable from any thread."""

    def __init__(self, folder: Path | None, *identity: object) -> None:
        """`identity` tells this bridge from all others of the machine."""
        self._lock = threading.Lock()  # each link has a thread of its own
        self._times = Delivered(folder, *identity, "time")
        self._digests = Delivered(folder, *identity, "digest")

    def time_of(self, topic: Topic, content: bytes, endpoint: str, received_ns: int, *, first: bool) -> int:
        """The time of a message that has just come: an earlier one, where the bridge before us had it already.

        Args:
            topic: the source.
            content: the message as it stood on its link.
            endpoint: address of the robot's process: the same words of another process are news.
            received_ns: the time now.
            first: whether it is the first one of this source here.
        """
        hashed = hashlib.blake2b(content, digest_size=8)
        hashed.update(endpoint.encode())
        digest = int.from_bytes(hashed.digest(), "little", signed=True)
        with self._lock:
            if first and self._digests.is_known(topic, digest):
                before = self._times.before(topic)
                if before is not None:
                    return before
            self._times.note(topic, received_ns)
            self._digests.note(topic, digest)
        return received_ns

    def forget(self, topic: Topic) -> None:
        """The source was lost, and that was said: when it comes back, its message is news."""
        with self._lock:
            self._digests.note(topic, 0)

    def close(self) -> None:
        """Close the files; they stay for the next bridge."""
        with self._lock:
            self._times.close()
            self._digests.close()
