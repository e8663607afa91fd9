"""The time by which runs wait."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["SteadyTime", "steady"]


class SteadyTime:
    """The wall clock's time at the start, and what has passed since.

    A computer without a clock of its own has it set some time after its start. Such a step is no time that a robot was
    silent or a task took. What a run wrote down is compared with the wall clock once, when the next server starts; a
    wall clock that is behind that cannot say how long nothing ran, so that no time counts as passed (`go_on_from`).
    """

    def __init__(self, clock: Callable[[], float], wall_s: Callable[[], float]) -> None:
        """Begin with the wall clock.

        Args:
            clock: seconds, never set.
            wall_s: seconds since 1970, which somebody may set.
        """
        self._clock = clock
        self._offset_s = wall_s() - clock()

    def __call__(self) -> float:
        """Seconds since 1970."""
        return self._offset_s + self._clock()

    def go_on_from(self, at: float) -> float:
        """Have no time passed since then, where then is still to come; by how many seconds the clock is behind."""
        behind_s = max(0.0, at - self())
        self._offset_s += behind_s
        return behind_s


def steady(clock: Callable[[], float], wall_s: Callable[[], float]) -> SteadyTime:
    """A time that nobody sets, which begins now; see `SteadyTime`."""
    return SteadyTime(clock, wall_s)
