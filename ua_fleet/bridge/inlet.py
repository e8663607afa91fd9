"""The one bounded queue between a driver's threads and the bridge's event loop, with a lane for executions.

    facts of executions      at once, before everything else, for one turn of the event loop at a time
    all else                 in its order: samples, and what is said of their sources

Before the end of an execution go the samples of its robot that wait, so that whoever hears of the end does not then
decide by an older value: all of them where they are few, else the newest of each source. Large ones do not: they would
keep the end back.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Final

from ua_fleet.bridge.doorbell import Doorbell
from ua_fleet.bridge.driver import (
    DriverEvent,
    Dropped,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
    ExecutionProgressed,
    ExecutionResumed,
    ExecutionSuspended,
    SampleRead,
)
from ua_fleet.bridge.lag import LagMeter
from ua_fleet.bridge.lane import ExecutionLane
from ua_fleet.bridge.source_facts import SourceFacts
from ua_fleet.counters import Drop
from ua_fleet.topics import Topic

__all__ = ["BoundedInlet"]

_BATCH: Final = 128
"""Events handed on before the event loop gets its turn again."""
_TURN_S: Final = 0.004
"""And so long at most, whatever they are: a request that comes in waits for this one turn."""
_DETAILS: Final = 64
"""Different details of drops that are kept while the loop is busy; the counts of the others go on without."""
_FACTS: Final = (
    ExecutionProgressed,
    ExecutionSuspended,
    ExecutionResumed,
    ExecutionEnded,
    ExecutionForgotten,
    ExecutionNotBegun,
)
_ENDS: Final = (ExecutionEnded, ExecutionForgotten)
_FEW: Final = 32
"""Samples of a robot that may all go before an end of it."""
_SMALL: Final = 4096
"""Elements, or characters, of a sample that may go before an end."""
_LOOKS: Final = 8
"""A full queue is looked through for old samples so many times within the age that they may have."""

_Waiting = tuple[float, SampleRead]
"""When a sample came here, less the time that it had waited before."""


def _nobody(_execution_id: bytes) -> Collection[Topic]:
    return ()


class BoundedInlet:
    """Takes events from any thread, hands them on in the event loop, and wakes it once for each batch.

    Samples are bounded in their number and their age: the oldest goes when a new one finds no place, and one that has
    waited for too long goes where a newer one of its source waits, so that the last one of each source always comes
    through. Of each execution a few facts wait (see `lane`), and of each source that comes and goes too (see
    `source_facts`). Drops are summed up, since their order says nothing.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        size: int,
        deliver: Callable[[DriverEvent], None],
        batch: int = _BATCH,
        *,
        max_wait_s: float = float("inf"),
        max_ages: Mapping[Topic, float] | None = None,
        lag: LagMeter | None = None,
        sources_of: Callable[[bytes], Collection[Topic]] = _nobody,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Make an inlet that keeps what it gets until `open`.

        Args:
            loop: the event loop that `deliver` is called in.
            size: most samples that may wait.
            deliver: takes the events; must not block.
            batch: most events handed on in one go.
            max_wait_s: how long a sample may wait where a newer one of its source waits too.
            max_ages: the same for sources whose values are of now for a shorter time.
            lag: told how long each sample took until `deliver` returned.
            sources_of: the data of the robot that an execution belongs to, by the execution's id; asked in the loop.
            clock: seconds that go on, whatever becomes of the wall clock.
        """
        self._loop, self._size, self._deliver, self._batch = loop, size, deliver, batch
        self._max_wait_s, self._sources_of, self._clock = max_wait_s, sources_of, clock
        self._max_ages = {topic: age_s for topic, age_s in (max_ages or {}).items() if age_s < max_wait_s}
        self._shortest_s = min(self._max_ages.values(), default=max_wait_s)
        self._lag = lag or LagMeter()
        self._lock = threading.Lock()
        self._lane = ExecutionLane()
        self._samples: deque[_Waiting | None] = deque()
        """None where one was taken out of its turn."""
        self._taken_in = 0
        """Samples put so far: the number of the oldest one that waits is this less the length of the queue."""
        self._held = 0
        self._facts = SourceFacts()
        self._drops: Counter[tuple[Drop, str]] = Counter()
        self._look_at = float("-inf")
        self._bell: Doorbell | None = None
        """There once it is open."""
        self._closed = False
        self._scheduled = False
        self.arrived_at: float | None = None
        """While a sample is handed on: when the driver got it, on this inlet's clock."""

    def put(self, event: DriverEvent) -> None:
        """Hand over an event; callable from any thread, never blocks. Does nothing once closed."""
        with self._lock:
            if self._closed:
                return
            if isinstance(event, SampleRead):
                if self._held >= self._size:
                    self._drop_oldest()
                self._samples.append((self._clock() - event.waited_s, event))
                self._held += 1
                self._taken_in += 1
            elif isinstance(event, _FACTS):
                if pushed_out := self._lane.put(event):
                    self._count(Drop.RATE_LIMITED, pushed_out)
            elif isinstance(event, Dropped):
                self._count(event.cause, event.count, event.detail)
            else:
                self._facts.put(event, self._taken_in)
            bell = self._bell
            if bell is None or self._scheduled:
                return
            self._scheduled = True
        bell.ring()  # without the lock, which the loop would wait for

    @property
    def waiting(self) -> int:
        """Samples that wait."""
        return self._held

    def oldest_s(self) -> float:
        """How long the sample has waited that has waited longest; 0 where none does."""
        with self._lock:
            since = next((waiting[0] for waiting in self._samples if waiting is not None), None)
        return 0.0 if since is None else max(self._clock() - since, 0.0)

    def open(self) -> None:
        """Begin to hand events on, those that wait first. Called in the event loop."""
        with self._lock:
            if self._bell is None and not self._closed:
                self._bell = Doorbell(self._loop, self._drain)
                self._scheduled = True
                self._loop.call_soon(self._drain)

    def close(self) -> None:
        """Take nothing more and forget what waits. Called in the event loop, which may be closed after this."""
        bell, self._bell = self._bell, None
        if bell is not None:
            bell.close()
        with self._lock:
            self._closed = True
            self._lane.clear()
            self._samples.clear()
            self._facts.clear()
            self._drops.clear()
            self._held = 0

    def _count(self, cause: Drop, count: int = 1, detail: str = "") -> None:
        key = (cause, detail)
        if key not in self._drops and len(self._drops) >= _DETAILS:
            key = (cause, "")
        self._drops[key] += count

    def _drop_oldest(self) -> None:
        while self._samples.popleft() is None:
            pass
        self._held -= 1
        self._count(Drop.INLET_FULL)

    def _drain(self) -> None:
        """Hand on what waits, until this turn is over."""
        executions, sources, facts = self._lane.facts, self._facts.facts, self._facts
        now = self._clock()
        until = now + _TURN_S
        with self._lock:
            self._drop_old(now)
        for _ in range(self._batch):
            if executions:
                self._hand_on_lane(until)
            with self._lock:
                if not self._samples and not sources:
                    break
                number = self._taken_in - len(self._samples)
                if sources and (first := facts.first) is not None and first <= number:
                    event: DriverEvent = facts.pop()
                    arrived = None
                elif (waiting := self._samples.popleft()) is None:
                    continue
                else:
                    arrived, event = waiting
                    self._held -= 1
                    if facts.is_void(event.topic, number):
                        self._count(Drop.INLET_FULL)
                        continue
            now = self._hand_on(event, arrived)
            if now >= until:
                break
        if executions and now < until:
            self._hand_on_lane(until)
        with self._lock:
            drops = self._take_drops() if self._drops else ()
            if self._samples or sources or executions:
                self._loop.call_soon(self._drain)
            else:
                self._scheduled = False
        for drop in drops:
            self._hand_on(drop, None)

    def _take_drops(self) -> list[Dropped]:
        drops = [Dropped(cause, count, detail) for (cause, detail), count in self._drops.items()]
        self._drops.clear()
        return drops

    def _hand_on_lane(self, until: float) -> None:
        """The facts of executions that wait, until the turn is over, and before an end what its robot had said."""
        now = float("-inf")
        while self._lane and now < until:
            with self._lock:
                fact = self._lane.pop()
            if isinstance(fact, _ENDS) and self._held:
                topics = self._sources_of(fact.execution_id)
                with self._lock:
                    ahead = self._take_ahead(frozenset(topics))
                for arrived, sample in ahead:
                    self._hand_on(sample, arrived)
            now = self._hand_on(fact, None)

    def _hand_on(self, event: DriverEvent, arrived: float | None) -> float:
        """Hand one event on; the time after it."""
        self.arrived_at = arrived
        try:
            self._deliver(event)
        except Exception as error:  # noqa: BLE001 - whatever is wrong with one event, facts are behind it
            said = f"an event could not be taken in: {type(event).__name__}"
            self._loop.call_exception_handler({"message": said, "exception": error})
        now = self._clock()
        if arrived is not None:
            self._lag.observe(now - arrived, now)
        return now

    def _take_ahead(self, topics: Collection[Topic]) -> Iterable[_Waiting]:
        """Take the samples of these sources that are small; leave those alone that something else is to precede."""
        later = self._facts.topics
        found: dict[Topic, list[int]] = {}
        left_out: set[Topic] = set()
        for index, waiting in enumerate(self._samples):
            if waiting is None or (topic := waiting[1].topic) not in topics or topic in later:
                continue
            if not _is_small(waiting[1]):
                left_out.add(topic)
            found.setdefault(topic, []).append(index)
        for topic in left_out:  # one that stays behind would come after those that went
            del found[topic]
        all_go = sum(map(len, found.values())) <= _FEW
        ahead: list[tuple[int, _Waiting]] = []
        for indices in found.values():
            newest = indices[-1]
            for index in indices:
                waiting = self._samples[index]
                assert waiting is not None
                if all_go or index == newest:
                    ahead.append((index, waiting))
                else:
                    self._count(Drop.TOO_OLD)
        gone = {index for indices in found.values() for index in indices}
        if gone:
            self._held -= len(gone)
            kept: Iterable[Any] = (None if index in gone else one for index, one in enumerate(self._samples))
            self._samples = deque(kept)
        return [waiting for _, waiting in sorted(ahead, key=lambda each: each[0])]

    def _drop_old(self, now: float) -> None:
        """Drop samples that have waited for too long, where a newer one of their source waits."""
        samples = self._samples
        if len(samples) < 2 or now < self._look_at:
            return
        first = next((waiting for waiting in samples if waiting is not None), None)
        if first is None or now - first[0] <= self._shortest_s:
            return
        self._look_at = now + self._shortest_s / _LOOKS
        newer: set[Topic] = set()
        kept: deque[_Waiting | None] = deque()
        dropped = 0
        for waiting in reversed(samples):
            if waiting is not None:
                topic = waiting[1].topic
                if topic in newer and now - waiting[0] > self._max_ages.get(topic, self._max_wait_s):
                    waiting = None
                    dropped += 1
                newer.add(topic)
            kept.appendleft(waiting)
        if dropped:
            self._samples = kept
            self._held -= dropped
            self._count(Drop.TOO_OLD, dropped)


def _is_small(sample: SampleRead) -> bool:
    """Whether a sample has few elements, as poses, states and numbers have, and images have not."""
    return sum([len(value) for value in sample.values if hasattr(value, "__len__")]) <= _SMALL
