"""Which writers live, and whose last value is of now.

    attested   the value that was handed on last is what the writer has now: data that was taken, a repeat of it, or a
               keep-alive whose sequence number says that nothing came between
    alive      the writer is there, but what it has now is not known: it was started anew and has said nothing yet, or
               its last message was lost or dropped
    silent     neither for MessageReceiveTimeout

A message that is dropped is no sign of anything, since it may say the opposite of what was taken last.

A writer may have a maximum age. Where it says so itself, it also says when its value is too old, and what attests the
value does so for that time, where it is shorter than MessageReceiveTimeout. Of another one only data tells that its
source was read, and a value that is too old is attested by nothing.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count

from ua_fleet.pubsub.events import SourceAppeared, SourceReturned, SourceSilent, SourceStale, SubscriberEvent
from ua_fleet.pubsub.remote_writer import RemoteWriter

__all__ = ["Liveness"]


class Liveness:
    """The deadlines of all writers of one process."""

    def __init__(self, timeout_s: float) -> None:
        """Know no writers; `timeout_s` is MessageReceiveTimeout."""
        self._timeout = timeout_s
        self._deadlines: list[tuple[float, int, RemoteWriter]] = []
        """A valid one for each writer that is not silent, never later than its own, and looked at again then."""
        self._silent: dict[RemoteWriter, None] = {}
        """The longest silent first."""
        self._order = count(1)

    @property
    def longest_silent(self) -> RemoteWriter | None:
        """The first that may be forgotten, or None."""
        return next(iter(self._silent), None)

    def add(self, writer: RemoteWriter) -> None:
        """Follow a writer that was heard just now."""
        writer.entry = next(self._order)
        heapq.heappush(self._deadlines, (self._deadline(writer), writer.entry, writer))

    def forget(self, writer: RemoteWriter) -> None:
        """Follow a silent writer no longer."""
        self._silent.pop(writer, None)

    def attest(
        self, writer: RemoteWriter, now: float, events: list[SubscriberEvent], *, is_followed: bool = False
    ) -> None:
        """The last value of a writer is of now, or the one that follows at once."""
        if writer.max_age_s is not None and not writer.says_max_age and writer.said_at + writer.max_age_s <= now:
            self.live(writer, now, events)
            return
        writer.alive_at = writer.attested_at = now
        if writer.silent or writer.stale:
            self._silent.pop(writer, None)
            writer.silent = writer.stale = False
            self.add(writer)
            events.append(SourceReturned(writer.topic, is_followed))

    def alive(self, writer: RemoteWriter, now: float, events: list[SubscriberEvent]) -> None:
        """A keep-alive of a writer says that its value did not change; of one that has said none, that it is there."""
        if writer.metadata is not None and not writer.has_appeared:
            writer.has_appeared = True
            events.append(SourceAppeared(writer.topic))
        if (writer.silent or writer.stale) and not writer.has_said:
            self.live(writer, now, events)  # nobody has a value of it that could be of now
        else:
            self.attest(writer, now, events)

    def live(self, writer: RemoteWriter, now: float, events: list[SubscriberEvent]) -> None:
        """A writer is there, and what its value is now is not known."""
        writer.alive_at = now
        if writer.silent:
            del self._silent[writer]
            writer.silent, writer.stale = False, True
            self.add(writer)
            events.append(SourceStale(writer.topic))

    def end(self, writer: RemoteWriter, events: list[SubscriberEvent]) -> None:
        """A writer's publisher is gone: it is silent from now on, as if it had said nothing for the timeout."""
        if writer.silent or writer.metadata is None:
            return
        writer.entry = next(self._order)  # its deadline counts no more
        writer.silent, writer.stale = True, False
        writer.silences += 1
        self._silent[writer] = None
        events.append(SourceSilent(writer.topic))

    def poll(
        self, now: float, caught: Callable[[str, Exception], None] | None = None
    ) -> tuple[list[SubscriberEvent], list[RemoteWriter]]:
        """What time has brought, and the writers to forget: they never said what they send.

        A mistake about one writer is told to `caught`, and costs that one a MessageReceiveTimeout, the others nothing.
        Without `caught` it is raised.
        """
        events: list[SubscriberEvent] = []
        nameless: list[RemoteWriter] = []
        deadlines = self._deadlines
        while deadlines and deadlines[0][0] <= now:
            _, order, writer = heapq.heappop(deadlines)
            try:
                self._look(writer, order, now, events, nameless)
            except Exception as error:  # counted; the other writers are looked at
                if caught is None:
                    raise
                heapq.heappush(deadlines, (now + self._timeout, order, writer))
                caught("silences", error)
        return events, nameless

    def _look(
        self,
        writer: RemoteWriter,
        order: int,
        now: float,
        events: list[SubscriberEvent],
        nameless: list[RemoteWriter],
    ) -> None:
        """The time of a writer's deadline has come."""
        if order != writer.entry:
            return
        deadline = self._deadline(writer)
        if deadline > now:
            heapq.heappush(self._deadlines, (deadline, order, writer))
        elif writer.metadata is None:
            nameless.append(writer)
        elif writer.alive_at + self._timeout > now:
            writer.stale = True
            heapq.heappush(self._deadlines, (self._deadline(writer), order, writer))
            events.append(SourceStale(writer.topic))
        else:
            writer.silent, writer.stale = True, False
            writer.silences += 1
            self._silent[writer] = None
            events.append(SourceSilent(writer.topic))

    def next_deadline(self) -> float | None:
        """When `poll` is to be called next, or None. It may have nothing to say then."""
        return self._deadlines[0][0] if self._deadlines else None

    def _deadline(self, writer: RemoteWriter) -> float:
        if writer.metadata is None:
            return writer.last_heard + self._timeout
        if writer.stale:
            return writer.alive_at + self._timeout
        deadline = min(writer.alive_at, writer.attested_at) + self._timeout
        if writer.max_age_s is None or not writer.has_said or writer.is_gone:
            return deadline
        return min(deadline, (writer.attested_at if writer.says_max_age else writer.said_at) + writer.max_age_s)
