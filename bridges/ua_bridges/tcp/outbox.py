"""What is on its way to a robot's program: at once, or a field for each acknowledgement. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from ua_bridges.tcp.config import Framing, InterpreterLink
from ua_bridges.tcp.framing import FieldWriter
from ua_bridges.tcp.messages import Message, Type

__all__ = ["Encoded", "Outbox"]

MOST_WAITING: Final = 100
"""Messages that may wait for acknowledgements."""


class Encoded(NamedTuple):
    """A message that can be sent."""

    message: Message
    fields: tuple[bytes, ...]


class Outbox:
    """Messages in their order, never one within another."""

    def __init__(self, link: InterpreterLink, write: Callable[[bytes], bool]) -> None:
        self._writer, self._write = FieldWriter(link), write
        self._one_by_one = link.framing is Framing.ACKNOWLEDGED
        self._waiting: deque[Encoded] = deque()
        self._fields: deque[bytes] = deque()
        self.waits_since: float | None = None
        """When the field was sent that has not been acknowledged."""

    @property
    def is_full(self) -> bool:
        """Whether more waits than a program that works lets wait."""
        return len(self._waiting) > MOST_WAITING

    def encode(self, message: Message) -> Encoded:
        """The bytes of a message; raises SkillRejected for what cannot be sent."""
        return Encoded(message, self._writer.encode_all(message.fields()))

    def send(self, encoded: Encoded, now: float) -> bool:
        """Send it, or have it wait; False where the connection is over.

        Of information that waits, the latest of its subtype counts.
        """
        if not self._one_by_one:
            return self._write(b"".join(encoded.fields))
        message = encoded.message
        if message.type is Type.INFORMATION and message.number == 0:
            for index, (waiting, _) in enumerate(self._waiting):
                if (waiting.type, waiting.subtype, waiting.number) == (message.type, message.subtype, 0):
                    self._waiting[index] = encoded
                    return True
        self._waiting.append(encoded)
        return self.waits_since is not None or self._next(now)

    def acknowledged(self, now: float) -> bool:
        """The robot has read a field; False where none was sent."""
        if self.waits_since is None:
            return False
        self.waits_since = None
        self._next(now)
        return True

    def clear(self) -> None:
        """The connection is gone, and what was half sent with it."""
        self._waiting.clear()
        self._fields.clear()
        self.waits_since = None

    def _next(self, now: float) -> bool:
        if not self._fields and self._waiting:
            self._fields.extend(self._waiting.popleft().fields)
        if not self._fields:
            return True
        self.waits_since = now
        return self._write(self._fields.popleft())
