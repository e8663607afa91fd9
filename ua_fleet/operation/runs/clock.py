"""The time by which runs wait."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["steady"]


def steady(clock: Callable[[], float], wall_s: Callable[[], float]) -> Callable[[], float]:
    """The wall clock's time at the start, and what has passed since.

    A computer without a clock of its own has it set some time after its start. Such a step is no time that a robot was
    silent or a task took. What a run wrote down is compared with the wall clock once, when the next server starts.

    Args:
        clock: seconds, never set.
        wall_s: seconds since 1970, which somebody may set.
    """
    offset_s = wall_s() - clock()
    return lambda: offset_s + clock()
