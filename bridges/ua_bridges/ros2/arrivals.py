"""How long messages have waited in their subscriptions before the node's thread came to them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Final

from ua_fleet.bridge.driver import DriverEvent, Inlet, SampleRead
from ua_fleet.topics import Topic

__all__ = ["Arrivals"]

_AT_ONCE_S: Final = 0.001
"""A shorter wait is the way from the middleware to the callback, and not told."""


class Arrivals:
    """The inlet for the node's thread; samples that are put while a message is read tell how long that one has waited.

    A subscription holds up to a thousand messages: without this they would be as good as new when they are read.
    """

    def __init__(
        self,
        inlet: Inlet,
        max_wait_s: float = float("inf"),
        wall_ns: Callable[[], int] = time.time_ns,
        max_ages: Mapping[Topic, float] | None = None,
    ) -> None:
        """Make it.

        Args:
            inlet: gets everything.
            max_wait_s: a message that has waited for longer is too old where a newer one comes.
            wall_ns: the wall clock, ns since 1970, by which the middleware stamps what it receives.
            max_ages: the same for sources whose values are of now for a shorter time.
        """
        self._put, self._max_wait_s, self._wall_ns = inlet.put, max_wait_s, wall_ns
        self._max_ages = max_ages or {}
        self._waited_s, self._thread = 0.0, 0

    def put(self, event: DriverEvent) -> None:
        """See Inlet. What a rate limit hands on later, in another thread, has waited for its turn alone."""
        if self._waited_s and type(event) is SampleRead and threading.get_ident() == self._thread:
            event = event._replace(waited_s=self._waited_s)
        self._put(event)

    def max_wait_s(self, topics: Iterable[Topic | None]) -> float:
        """How long a message may wait that these DataSets are read from: as long as one of them still takes it."""
        most_s = self._max_wait_s
        ages_s = [most_s if topic is None else self._max_ages.get(topic, most_s) for topic in topics]
        return min(max(ages_s, default=most_s), most_s)

    def begin(self, received_ns: int, max_wait_s: float) -> bool:
        """A message that the middleware received at that time is read from now on; whether it is too old."""
        waited_s = (self._wall_ns() - received_ns) / 1e9
        if waited_s >= _AT_ONCE_S:
            self._waited_s, self._thread = waited_s, threading.get_ident()
        return waited_s > max_wait_s

    def end(self) -> None:
        """It is read."""
        self._waited_s = 0.0
