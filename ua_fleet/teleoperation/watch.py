"""Which setpoints count: freshness without clocks. Pure; time is an argument, and is this process's own alone.

The bridge publishes a counter, each time another one. A setpoint echoes the newest counter that the operator's device
had seen when the operator wished it. So the wish cannot be older than that counter, by the bridge's own clock, wherever
the counter or the setpoint was kept waiting. A setpoint counts until its counter is `deadman_s` old, and not longer:
whatever is drawn out on the way shortens the time for which a wish counts, and never lengthens it.

A setpoint is taken only

    lease      under the lease that is held now
    number     with a greater number than the last one taken
    echo       with a counter that was published no longer than `deadman_s` ago
    setpoint   with as many values as there are axes, all finite

and is else dropped by that cause, the first that applies. What is dropped feeds nothing. A value beyond the limit of
its axis is held within it (`ramp.py`): a stick at its end is no mistake, and refusing it would stop the robot.
"""

from __future__ import annotations

import math
from collections import deque

from ua_fleet.counters import Drop
from ua_fleet.teleoperation.messages import Setpoint

__all__ = ["Echoes", "Watch"]


class Echoes:
    """When the latest counters were published."""

    def __init__(self, deadman_s: float) -> None:
        """Begin with none."""
        self._deadman_s = deadman_s
        self._published: deque[tuple[int, float]] = deque()
        self.counter = 0
        """The last one; 0 before the first."""

    def count(self, now: float) -> int:
        """A counter that is published now."""
        self.counter = self.counter % 0xFFFF_FFFF + 1
        self._published.append((self.counter, now))
        self._forget(now)
        return self.counter

    def fresh_until(self, counter: int, now: float) -> float | None:
        """Until when what echoes a counter counts; None where it does not any more, or was never published."""
        self._forget(now)
        for published, at in reversed(self._published):
            if published == counter:
                return at + self._deadman_s
        return None

    def _forget(self, now: float) -> None:
        while self._published and now >= self._published[0][1] + self._deadman_s:
            self._published.popleft()


class Watch:
    """The setpoints of one lease."""

    def __init__(self, lease: int, axes: int, echoes: Echoes) -> None:
        """Begin with none."""
        self._lease, self._axes, self._echoes = lease, axes, echoes
        self.number = 0
        """Of the last one taken; 0 before the first."""
        self.values = (0.0,) * axes
        """What it wishes."""
        self.fresh_until: float | None = None
        """Until when it counts; None before the first."""

    def take(self, setpoint: Setpoint, now: float) -> Drop | None:
        """Take a setpoint, or say why not."""
        if setpoint.lease != self._lease:
            return Drop.LEASE
        if setpoint.number <= self.number:
            return Drop.NUMBER
        fresh_until = self._echoes.fresh_until(setpoint.echo, now)
        if fresh_until is None:
            return Drop.ECHO
        if len(setpoint.values) != self._axes or not all(map(math.isfinite, setpoint.values)):
            return Drop.SETPOINT
        self.number, self.values, self.fresh_until = setpoint.number, setpoint.values, fresh_until
        return None

    def is_over(self, now: float) -> bool:
        """Whether there was a setpoint, and none is fresh any more."""
        return self.fresh_until is not None and now >= self.fresh_until
