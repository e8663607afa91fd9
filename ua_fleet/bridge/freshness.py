"""How old the last value of a source may be, and which are too old. Pure.

A source has a maximum age where `fleet.yaml` gives it one (`max_age_s`), or where its messages come with a period:
after 20 intervals whose deviation is below 30 % it has ten of them, at least 3 s. It is read with each of its messages,
and where it is polled with each reading that brought the same values. What comes with another period later has another
maximum age; what comes with none keeps the one that it had.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Mapping
from itertools import count
from typing import Final

from ua_fleet.bridge.driver import SourceFound
from ua_fleet.topics import Topic

__all__ = ["Freshness", "Rhythm"]

INTERVALS: Final = 20
MOST_DEVIATION: Final = 0.3
PERIODS: Final = 10
LEAST_LEARNED_S: Final = 3.0
TOLERANCE: Final = 0.25
"""Another maximum age is announced only where it differs by more than this part of the one before."""


class Rhythm:
    """The period of one source."""

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._intervals_s: list[float] = []

    def take(self, time_ns: int) -> float | None:
        """A message with this time has come; the period in s where `INTERVALS` of them are alike, else None."""
        last, self._last_ns = self._last_ns, time_ns
        if last is None or time_ns <= last:  # a clock that was set back
            self._intervals_s.clear()
            return None
        intervals = self._intervals_s
        intervals.append((time_ns - last) / 1e9)
        if len(intervals) < INTERVALS:
            return None
        mean = sum(intervals) / INTERVALS
        deviation = math.sqrt(sum([(each - mean) ** 2 for each in intervals]) / INTERVALS)
        intervals.clear()
        return mean if deviation < MOST_DEVIATION * mean else None


class _Source:
    __slots__ = ("entry", "found", "is_stale", "is_there", "max_age_s", "read_at", "rhythm", "status")

    def __init__(self, found: SourceFound, max_age_s: float | None) -> None:
        self.found = found
        self.max_age_s = max_age_s
        self.rhythm = Rhythm() if max_age_s is None and found.may_have_period else None
        self.read_at = -math.inf
        self.status = 0
        """Of the last message."""
        self.is_there = True
        self.is_stale = False
        self.entry = 0
        """Number of its valid deadline; 0 for none."""


class Freshness:
    """The sources of one space that have a maximum age, or may get one."""

    def __init__(self, configured: Mapping[Topic, float]) -> None:
        """Know no sources; `configured` are the `max_age_s` of `fleet.yaml`."""
        self._configured = configured
        self._sources: dict[Topic, _Source] = {}
        self._deadlines: list[tuple[float, int, Topic]] = []
        """One that is valid for each that was read and is not stale, never later than its own."""
        self._order = count(1)
        self.is_nearer = False
        """Whether a deadline came that may be nearer than the next one was; whoever sets a timer takes it back."""

    def found(self, found: SourceFound) -> float | None:
        """A source is there; its maximum age in s, None where it has none."""
        topic = found.topic
        max_age_s = self._configured.get(topic)
        known = self._sources.pop(topic, None)
        if max_age_s is None and not found.may_have_period:
            return None
        source = _Source(found, max_age_s)
        if known is not None and known.is_there and known.found.fields == found.fields:
            source, source.found = known, found  # it was only said again
        elif known is not None and source.rhythm is not None:
            source.max_age_s = known.max_age_s  # the same robot, which was away
        self._sources[topic] = source
        return source.max_age_s

    def lost(self, topic: Topic) -> None:
        """A source is gone: its value is not of now anyhow."""
        source = self._sources.get(topic)
        if source is not None:
            source.is_there = source.is_stale = False

    def forget(self, topic: Topic) -> None:
        """A source will not come back."""
        self._sources.pop(topic, None)

    def told(self, topic: Topic, time_ns: int, status: int, now: float) -> SourceFound | None:
        """A message of a source came. The source again where its maximum age is another one now."""
        source = self._sources.get(topic)
        if source is None:
            return None
        source.status = status
        source.is_stale = False
        self._read(topic, source, now)
        if source.rhythm is None or (period_s := source.rhythm.take(time_ns)) is None:
            return None
        before, learned = source.max_age_s, max(LEAST_LEARNED_S, PERIODS * period_s)
        if before is not None and abs(learned - before) <= TOLERANCE * before:
            return None
        source.max_age_s, source.entry = learned, 0
        self._read(topic, source, now)
        return source.found

    def read(self, topic: Topic, now: float) -> int | None:
        """A source was read and says the same. Its status where that has to be said, since it was stale; else None."""
        source = self._sources.get(topic)
        if source is None or source.read_at == -math.inf:
            return None
        was_stale, source.is_stale = source.is_stale, False
        self._read(topic, source, now)
        return source.status if was_stale else None

    def is_stale(self, topic: Topic) -> bool:
        """Whether the last value of a source is too old."""
        source = self._sources.get(topic)
        return source is not None and source.is_stale

    def take_stale(self, now: float) -> list[Topic]:
        """The sources whose last value has become too old."""
        stale: list[Topic] = []
        deadlines = self._deadlines
        while deadlines and deadlines[0][0] <= now:
            _, order, topic = deadlines[0]
            source = self._sources.get(topic)
            if source is None or source.entry != order or source.max_age_s is None:
                heapq.heappop(deadlines)
            elif source.read_at + source.max_age_s > now:
                heapq.heapreplace(deadlines, (source.read_at + source.max_age_s, order, topic))
            else:
                heapq.heappop(deadlines)
                source.entry = 0
                if source.is_there:
                    source.is_stale = True
                    stale.append(topic)
        return stale

    def next_deadline(self) -> float | None:
        """When `take_stale` is to be called next, or None."""
        return self._deadlines[0][0] if self._deadlines else None

    def _read(self, topic: Topic, source: _Source, now: float) -> None:
        source.read_at = now
        if source.max_age_s is not None and not source.entry:
            source.entry = next(self._order)
            self.is_nearer = True
            heapq.heappush(self._deadlines, (now + source.max_age_s, source.entry, topic))
