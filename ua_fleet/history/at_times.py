"""Values at given times: ReadAtTime (OPC 10000-11 6.5.5)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from ua_fleet.history.bounds import Settings, interpolated_bound, simple_bound
from ua_fleet.history.rows import Row, Series
from ua_fleet.history.window import window

__all__ = ["read_at_times"]


def read_at_times(series: Series, times: Iterable[int], settings: Settings, *, simple: bool) -> Iterator[Row]:
    """A value for each of the times, in their order: the one that was recorded then, or an interpolated one.

    Each is looked for when it is taken, so that no more of them are in memory than an answer has room for.

    Args:
        series: of the node.
        times: ticks.
        settings: how values count.
        simple: with simple bounding values in place of interpolated ones.
    """
    bound = simple_bound if simple else interpolated_bound
    for time in times:
        # A row of this very time is the first of those that are looked for after an empty stretch before it.
        yield bound(window(series, [], time, time - 1, settings), time).row
