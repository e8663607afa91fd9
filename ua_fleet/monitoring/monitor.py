"""What a process tells of itself. It is asked in the event loop, so that nothing that it reads changes meanwhile."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator
from typing import Final

from prometheus_client import CollectorRegistry, Histogram, ProcessCollector, disable_created_metrics
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from ua_fleet import __version__
from ua_fleet.monitoring.metrics import BUILD, LOOP_LAG, MISTAKES, READY, Family, ProcessKind
from ua_fleet.monitoring.mistakes import Mistakes

__all__ = ["Collect", "Monitor"]

Collect = Callable[[], Iterable[Family]]
"""Called at each scrape, in the event loop."""

LAG_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0)
_STARTING: Final = "it is starting"


class Monitor(Collector):
    """What one process tells of itself. Without an endpoint nobody asks, and it costs nothing."""

    def __init__(self, process: ProcessKind, name: str = "") -> None:
        """Make a monitor of a process that is not ready yet.

        Args:
            process: what it is.
            name: what `fleet.yaml` calls it.
        """
        disable_created_metrics()  # type: ignore[no-untyped-call]
        self._registry = CollectorRegistry(auto_describe=False)
        self._build = (process.value, name, __version__, platform.python_version())
        self.mistakes = Mistakes()
        """Those of the process."""
        self._collects: list[Collect] = []
        self._problem: Callable[[], str] = lambda: _STARTING
        self._ready_text: Callable[[], str] = str
        self._alive_text: Callable[[], str] = lambda: "ok"
        self._lag = self.histogram(LOOP_LAG.name, LOOP_LAG.help, LAG_BUCKETS_S)
        ProcessCollector(registry=self._registry)
        self._registry.register(self)

    def histogram(self, name: str, text: str, buckets: tuple[float, ...], labels: tuple[str, ...] = ()) -> Histogram:
        """A histogram that is told at each scrape."""
        return Histogram(name, text, labels, registry=self._registry, buckets=buckets)

    def add(self, collect: Collect) -> None:
        """Tell these figures too."""
        self._collects.append(collect)

    def ready_when(self, problem: Callable[[], str], text: Callable[[], str] = str) -> None:
        """Be ready while `problem` says nothing.

        Args:
            problem: one line, why the process is not ready and what to do; empty while it is.
            text: one line for people while it is ready.
        """
        self._problem, self._ready_text = problem, text

    def alive_with(self, text: Callable[[], str]) -> None:
        """Say this of a process that answers, in one line that begins with `ok` or `degraded`."""
        self._alive_text = text

    def alive_text(self) -> str:
        """One line of a process that answers, with the mistakes that were caught in it."""
        said, mistakes = self._alive_text(), self.mistakes.text()
        return " ".join((f"{said}; {mistakes}" if mistakes else said).split())

    def problem(self) -> str:
        """Why the process is not ready, in one line; empty while it is."""
        return " ".join(self._problem().split())

    def ready_text(self) -> str:
        """One line of a process that is ready."""
        said = " ".join(self._ready_text().split())
        return f"ready: {said}" if said else "ready"

    def lagged(self, lag_s: float) -> None:
        """The event loop was so late."""
        self._lag.observe(lag_s)

    def collect(self) -> Iterator[Family]:
        """All figures but those of histograms; called by the registry."""
        yield BUILD.many([(self._build, 1)])
        yield READY.one(not self.problem())
        for collect in self._collects:
            # One part that cannot tell its figures must not take away those of the others.
            with self.mistakes.guard("metrics"):
                yield from list(collect())
        yield MISTAKES.many(((loop,), count) for loop, count in self.mistakes.counts.items())

    def exposition(self, accept: str = "") -> tuple[bytes, str]:
        """The figures in a format that a client accepts, and its content type."""
        encode, content_type = choose_encoder(accept)
        return encode(self._registry), content_type
