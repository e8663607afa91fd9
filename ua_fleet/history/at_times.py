"""Values at given times: ReadAtTime (OPC 10000-11 6.5.5)."""

from __future__ import annotations

from collections.abc import Sequence

from ua_fleet.history.bounds import Settings, interpolated_bound, simple_bound
from ua_fleet.history.rows import Row, Series
from ua_fleet.history.window import window

__all__ = ["read_at_times"]


def read_at_times(series: Series, times: Sequence[int], settings: Settings, *, simple: bool) -> list[Row]:
    """A value for each of the times, in their order: the one that was recorded then, or an interpolated one.

    Args:
        series: of the node.
        times: ticks.
        settings: how values count.
        simple: with simple bounding values in place of interpolated ones.
    """
    bound = simple_bound if simple else interpolated_bound
    return [bound(window(series, time, time, settings).points, time).row for time in times]
