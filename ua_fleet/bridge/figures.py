"""What a bridge tells of itself: figures for Prometheus, and whether it is ready."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator

from ua_fleet.bridge.driver import Driver
from ua_fleet.bridge.inlet import BoundedInlet
from ua_fleet.bridge.lag import MOST_LAG_S, LagMeter
from ua_fleet.counters import Counters
from ua_fleet.keys.keeper import KeysKept
from ua_fleet.monitoring import Monitor, metrics
from ua_fleet.monitoring.counted import counted, keys_left, transported
from ua_fleet.monitoring.metrics import Family
from ua_fleet.transport.connections import Connections, Sender

__all__ = ["BridgeFigures"]


class BridgeFigures:
    """Looks at the parts of a running bridge when it is asked."""

    def __init__(
        self,
        counters: Counters,
        driver: Driver,
        connections: Connections,
        inlet: BoundedInlet,
        keys: KeysKept,
        lag: LagMeter,
        sender: Sender,
    ) -> None:
        self._counters, self._driver, self._connections, self._inlet = counters, driver, connections, inlet
        self._envelopes, self._keys, self._lag, self._sender = connections.envelopes, keys, lag, sender

    def tell(self, monitor: Monitor) -> None:
        """Tell of the bridge from now on."""
        monitor.add(self.collect)
        monitor.ready_when(self.problem, self._text)
        monitor.alive_with(self._health)

    def _text(self) -> str:
        """How the robots are; and which connection does not work, where another one does."""
        return "; ".join(filter(None, (self._driver.status().detail, self._connections.problem)))

    def problem(self) -> str:
        """Why data does not pass; empty while it can."""
        status = self._driver.status()
        if not status.connected:
            return f"not connected to the space: {status.detail}"
        return self._connections.stats.problem or self._envelopes.problem or self.lag_problem()

    def lag_problem(self) -> str:
        """Why values are not of now; empty while they are."""
        p99_s, oldest_s = self.lags_s()
        if max(p99_s, oldest_s) <= MOST_LAG_S:
            return ""
        return (
            f"values come late: 99 of 100 are sent within {p99_s:.2g} s, and the oldest has waited {oldest_s:.2g} s; "
            "give the bridge more of a processor, or send it less (max_rate_hz)"
        )

    def lags_s(self) -> tuple[float, float]:
        """What 99 of 100 messages needed from the driver's callback to the wire, and how long the oldest has waited."""
        return self._lag.p99_s(time.monotonic()), max(self._inlet.oldest_s(), self._sender.oldest_s())

    def _health(self) -> str:
        p99_s, oldest_s = self.lags_s()
        state = "degraded" if self.lag_problem() else "ok"
        return f"{state}: lag p99 {p99_s * 1000:.1f} ms, oldest waiting {oldest_s * 1000:.1f} ms"

    def collect(self) -> Iterator[Family]:
        """All figures now."""
        yield from counted(self._counters, has_space=True)
        yield from transported(self._connections.stats)
        if self._envelopes.is_secured:
            now = asyncio.get_running_loop().time()
            yield from keys_left(self._envelopes.keys_last_s(now), self._keys.source_problem)
        status = self._driver.status()
        yield metrics.SPACE_CONNECTED.one(status.connected)
        yield metrics.DEVICE_UP.many(((name,), not reason) for name, reason in status.devices.items())
        yield metrics.ASIDE.one(len(status.aside))
        yield metrics.INLET.one(self._inlet.waiting)
        p99_s, oldest_s = self.lags_s()
        yield metrics.LAG.one(p99_s)
        yield metrics.OLDEST.one(oldest_s)
