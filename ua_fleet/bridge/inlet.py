"""The one bounded queue between a driver's threads and the bridge's event loop."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import Final

from ua_fleet.bridge.driver import DriverEvent, Dropped, ExecutionProgressed, SampleRead
from ua_fleet.counters import Drop

__all__ = ["BoundedInlet"]

_BATCH: Final = 128
"""Events handed on before the event loop gets its turn again."""
_SAMPLES: Final = (SampleRead, ExecutionProgressed)
_DETAILS: Final = 64
"""Different details of drops that are kept while the loop is busy; the counts of the others go on without."""


class BoundedInlet:
    """Takes events from any thread, hands them on in the event loop, in order, and wakes it once for each batch.

    Samples (and how far executions are) are bounded: the oldest goes when a new one finds no place. All other facts are
    never dropped, and stay before and after the samples that they came before and after. Drops are summed up, since
    their order says nothing.
    """

    def __init__(
        self, loop: asyncio.AbstractEventLoop, size: int, deliver: Callable[[DriverEvent], None], batch: int = _BATCH
    ) -> None:
        """Make an inlet that keeps what it gets until `open`.

        Args:
            loop: the event loop that `deliver` is called in.
            size: most samples that may wait.
            deliver: takes the events; must not block.
            batch: most events handed on in one go.
        """
        self._loop, self._size, self._deliver, self._batch = loop, size, deliver, batch
        self._lock = threading.Lock()
        self._samples: deque[SampleRead | ExecutionProgressed] = deque()
        self._taken_in = 0
        """Samples put so far: the number of the oldest one that waits is this less those that wait."""
        self._facts: deque[tuple[int, DriverEvent]] = deque()
        """Each with the number of samples put before it."""
        self._drops: Counter[tuple[Drop, str]] = Counter()
        self._open = False
        self._closed = False
        self._scheduled = False

    def put(self, event: DriverEvent) -> None:
        """Hand over an event; callable from any thread, never blocks. Does nothing once closed."""
        with self._lock:
            if self._closed:
                return
            if isinstance(event, _SAMPLES):
                if len(self._samples) >= self._size:
                    self._samples.popleft()
                    self._drops[Drop.INLET_FULL, ""] += 1
                self._samples.append(event)
                self._taken_in += 1
            elif isinstance(event, Dropped):
                key = (event.cause, event.detail)
                if key not in self._drops and len(self._drops) >= _DETAILS:
                    key = (event.cause, "")
                self._drops[key] += event.count
            else:
                self._facts.append((self._taken_in, event))
            if self._open and not self._scheduled:
                self._scheduled = True
                self._loop.call_soon_threadsafe(self._drain)

    @property
    def waiting(self) -> int:
        """Samples that wait."""
        return len(self._samples)

    def open(self) -> None:
        """Begin to hand events on, those that wait first. Called in the event loop."""
        with self._lock:
            self._open = True
            if not self._scheduled and not self._closed:
                self._scheduled = True
                self._loop.call_soon(self._drain)

    def close(self) -> None:
        """Take nothing more and forget what waits. The loop may be closed after this."""
        with self._lock:
            self._closed = True
            self._samples.clear()
            self._facts.clear()
            self._drops.clear()

    def _take(self) -> list[DriverEvent]:
        """At most one batch, in order."""
        samples, facts = self._samples, self._facts
        batch: list[DriverEvent] = []
        oldest = self._taken_in - len(samples)
        while len(batch) < self._batch and (facts or samples):
            if facts and facts[0][0] <= oldest:
                batch.append(facts.popleft()[1])
            else:
                batch.append(samples.popleft())
                oldest += 1
        if self._drops:
            batch.extend(Dropped(cause, count, detail) for (cause, detail), count in self._drops.items())
            self._drops.clear()
        return batch

    def _drain(self) -> None:
        with self._lock:
            batch = self._take()
            if self._facts or self._samples:
                self._loop.call_soon(self._drain)
            else:
                self._scheduled = False
        deliver = self._deliver
        for event in batch:
            try:
                deliver(event)
            except Exception as error:  # noqa: BLE001 - whatever is wrong with one event, facts are behind it
                said = f"an event could not be taken in: {type(event).__name__}"
                self._loop.call_exception_handler({"message": said, "exception": error})
